"""The product and its tests contain no word of the list below in comments, docstrings, messages, pages and names.

One list with replacements; a message that a test prints names the word, the place and what to write instead.
"""

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
    r"(?:is|are|was) (?-i:none)": "not found; missing; must be above 0",
    r"goes on|go on": "continues",
    r"of one's own|of somebody's own": "of your own",
    r"what is left": "residual; remainder",
    r"what there is": "available; present",
    r"puts? up with": "tolerate",
    r"mend(?:s|ed|ing)?": "fix",
    r"at hand": "available",
    r"comes of": "follows from",
    r"so long as": "while; if",
    r"in so far as|insofar as": "if; where",
    r"looks? whether": "checks whether",
    r"shaken": "excited",
    r"climbs?|climbed|climbing": "an ascending series; rises",
}
LIST = "|".join(REPLACEMENTS)
WORDS = re.compile(rf"\b({LIST})\b", re.IGNORECASE)
# In code an underscore separates the words of a name.
WORDS_IN_CODE = re.compile(rf"(?<![A-Za-z])({LIST})(?![A-Za-z])".replace(" ", "[ _]"), re.IGNORECASE)
# Without ignoring case a search takes a third of the time; most files have no such word.
WORDS_IN_LOWER_CASE = re.compile(WORDS_IN_CODE.pattern)
# The ripple that a person would hear is a term of the verdict, explained where it first appears.
TERMS = re.compile(r"\bheard\b.*\bripple\b|\bfelt, heard, moved\b", re.IGNORECASE)
# A function is a verb, a variable a noun; these are what happened to a value.
NAMES = re.compile(
    r"(?:^|_)(told|said|lent|lends|concluded|goes_on|go_on|nobody|somebody|anybody|whoever|believed|mended|shaken)(?:_|$)"
)
# Send, report; receive, read; accept; fix.
VERBS = re.compile(r"(?:^|_)(tells?|hears?|believes?|mends?)(?:_|$)")
# A text without any of these has no such name, and needs no parser.
PARTS = re.compile(rf"(?<![A-Za-z])(?:{NAMES.pattern[7:-7]}|{VERBS.pattern[7:-7]})(?![A-Za-z])")
# Keys of logs and of the page's messages, which old files hold: "said", "told"; names of tests.
KEYS = re.compile(r"\{said\}|[\"'](?:said|told)[\"']|detail\.told\b|\btold: report\b|::test_\w+")
JINJA = re.compile(r"\bis (?:not )?none\b")  # a comparison in a template
# Sources of the product that are not Python; code of others is not ours to write.
SOURCES = {".c", ".h", ".s", ".ld", ".js", ".html", ".css", ".j2", ".toml", ".rst", ".pyi", ".yml"}
OTHERS = {"uPlot.iife.min.js", "uPlot.min.css"}

# Names of the product with one of VERBS that are left to fix; it only falls.
VERBS_LEFT = 19
QUESTIONS = re.compile(r"def (test_(?:who|what|whether|whoever)_\w*)")  # a test's name is a claim


def has_words(text: str) -> bool:
    """Return True if a text may contain a word of the list; `None` of the code is not one of them."""
    return WORDS_IN_LOWER_CASE.search(text.replace("None", " ").lower()) is not None


def texts(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the line and text of each comment and string of a Python file that has a word of the list anywhere."""
    text = path.read_text(encoding="utf-8")
    if not has_words(text):
        return
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        kinds = (tokenize.COMMENT, tokenize.STRING, getattr(tokenize, "FSTRING_MIDDLE", tokenize.STRING))
        if token.type in kinds:
            for offset, line in enumerate(KEYS.sub("", token.string).split("\n")):
                yield token.start[0] + offset, line


def lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield number and text of each line of a file that has a word of the list anywhere, code included."""
    text = path.read_text(encoding="utf-8")
    if not has_words(text):
        return
    code = JINJA if path.suffix == ".j2" else KEYS
    for number, line in enumerate(text.split("\n"), 1):
        yield number, code.sub("", line)


def wrong_words(path: Path, read: Iterator[tuple[int, str]], words: re.Pattern[str] = WORDS) -> list[str]:
    """Return a message for each word of the list: place, word and replacement."""
    return [
        f"{path.relative_to(ROOT)}:{number}: {match[0]!r}; write: {replacement_of(match[0])}"
        for number, line in read
        if not TERMS.search(line)
        for match in words.finditer(line)
    ]


def replacement_of(word: str) -> str:
    plain = word.replace("_", " ")
    return next(text for pattern, text in REPLACEMENTS.items() if re.fullmatch(pattern, plain, re.IGNORECASE))


def names(module: str) -> Iterator[tuple[int, str]]:
    """Yield line and name of each function, class, parameter and variable that a module with such words defines."""
    if not PARTS.search(modules()[module].read_text(encoding="utf-8")):
        return
    for node in ast.walk(tree_of(module)):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            yield node.lineno, node.name
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.attr


def test_comments_docstrings_and_messages_use_plain_words() -> None:
    wrong = [one for path in modules().values() for one in wrong_words(path, texts(path))]
    assert wrong == [], "\n".join(wrong)


def test_pages_use_plain_words() -> None:
    places = [ROOT / ".github", *(ROOT / package for package in PACKAGES)]
    pages = [*ROOT.glob("*.md"), *(page for place in places for page in place.rglob("*.md"))]
    wrong = [one for page in pages for one in wrong_words(page, lines(page))]
    assert wrong == [], "\n".join(wrong)


def test_sources_in_other_languages_use_plain_words() -> None:
    paths = [
        path for package in PACKAGES for path in (ROOT / package).rglob("*") if path.suffix.lower() in SOURCES
    ]
    assert len(paths) > 150
    ours = [path for path in paths if path.name not in OTHERS]
    wrong = [one for path in ours for one in wrong_words(path, lines(path), WORDS_IN_CODE)]
    assert wrong == [], "\n".join(wrong)


def test_functions_classes_and_variables_have_names_of_the_field() -> None:
    found = [(f"{module}:{line}: {name}", name) for module in modules() for line, name in names(module)]
    assert [place for place, name in found if NAMES.search(name)] == []
    verbs = [place for place, name in found if VERBS.search(name)]
    assert len(verbs) <= VERBS_LEFT, verbs


def test_tests_use_plain_words() -> None:
    paths = [path for path in sorted((ROOT / "tests").rglob("*.py")) if path != Path(__file__)]
    wrong = [one for path in paths for one in wrong_words(path, lines(path), WORDS_IN_CODE)]
    for path in paths:
        found = QUESTIONS.findall(path.read_text(encoding="utf-8"))
        wrong += [f"{path.relative_to(ROOT)}: {name}; write a claim" for name in found]
    assert wrong == [], "\n".join(wrong)
