"""Plain English in the product: no word of the list in comments, docstrings, messages, pages and names.

One list with replacements; a message that a test prints names the word, the place and what to write instead.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

from tests.conformance.tree import PACKAGES, ROOT, modules, tree_of

# What to write in place of each. A device sends, reports, contains, checks, rejects: it does not talk, know or believe.
REPLACEMENTS = {
    r"told|tells": "the device reports, the host sends, the page shows",
    r"said": "answered; reported; printed",
    r"nobody|somebody|anybody|whoever": "name the actor: the operator, the caller, another host",
    r"hears|heard of": "receives; detects",
    r"believe[sd]?": "assumed; accepted; estimated",
    r"lent|lends": "temporarily registered",
    r"(?:is|are|was) none": "not found; missing; must be above 0",
    r"goes on|go on": "continues",
    r"of one's own|of somebody's own": "of your own",
    r"what is left": "residual; remainder",
    r"what there is": "available; present",
    r"puts? up with": "tolerate",
    r"mend(?:s|ed|ing)?": "fix",
    r"at hand": "available",
    r"comes of": "follows from",
}
WORDS = re.compile(rf"\b({'|'.join(REPLACEMENTS)})\b", re.IGNORECASE)
# The ripple that a person would hear is a term of the verdict, explained where it first appears.
TERMS = re.compile(r"\bheard\b.*\bripple\b|\bfelt, heard, moved\b", re.IGNORECASE)
# A function is a verb; these are what happened to a value.
NAMES = re.compile(
    r"(?:^|_)(told|said|lent|concluded|goes_on|go_on|nobody|somebody|whoever|believed|mended)(?:_|$)"
)
# Keys of logs and of the page's messages, which old files hold: "said", "told".
KEYS = re.compile(r"\{said\}|\"(?:said|told)\"")


def texts(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the line and text of each comment and string of a Python file."""
    for token in tokenize.generate_tokens(io.StringIO(path.read_text(encoding="utf-8")).readline):
        kinds = (tokenize.COMMENT, tokenize.STRING, getattr(tokenize, "FSTRING_MIDDLE", tokenize.STRING))
        if token.type in kinds:
            for offset, line in enumerate(KEYS.sub("", token.string).split("\n")):
                yield token.start[0] + offset, line


def wrong_words(path: Path, lines: Iterator[tuple[int, str]]) -> list[str]:
    """Return a sentence for each word of the list."""
    return [
        f"{path.relative_to(ROOT)}:{number}: {match[0]!r}; write: {replacement_of(match[0])}"
        for number, line in lines
        if not TERMS.search(line)
        for match in WORDS.finditer(line)
    ]


def replacement_of(word: str) -> str:
    return next(text for pattern, text in REPLACEMENTS.items() if re.fullmatch(pattern, word, re.IGNORECASE))


def test_comments_docstrings_and_messages_use_plain_words() -> None:
    assert [wrong for path in modules().values() for wrong in wrong_words(path, texts(path))] == []


def test_pages_use_plain_words() -> None:
    pages = [*ROOT.glob("*.md"), *(page for package in PACKAGES for page in (ROOT / package).rglob("*.md"))]
    assert [
        wrong
        for page in pages
        for wrong in wrong_words(page, enumerate(page.read_text(encoding="utf-8").split("\n"), 1))
    ] == []


def test_functions_and_classes_have_names_of_the_field() -> None:
    named = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    assert [
        f"{module}:{node.lineno}: {node.name}"
        for module in modules()
        for node in ast.walk(tree_of(module))
        if isinstance(node, named) and NAMES.search(node.name)
    ] == []
