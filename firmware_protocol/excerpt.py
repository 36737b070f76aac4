"""Build one C text from the firmware's sources that contains only the declarations that some functions need.

`rig.firmware` exports estimators with it. The sources consist of declarations at the outermost level, each below its
comment. `excerpt` follows the names that each declaration uses and joins the needed declarations in the order of the
sources. Every name gets a prefix and every function is static, so a program can include two excerpts. It is not a C
parser and must not be used for other sources.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

_TOKEN = re.compile(
    r'/\*.*?\*/|"(?:\\.|[^"\\])*"|\'(?:\\.|[^\'\\])+\'|^[ \t]*#[^\n]*|[{};]', re.DOTALL | re.MULTILINE
)
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_NAME = re.compile(r"[A-Za-z_]\w*")
_FUNCTION = re.compile(r"\b([a-z]\w*)\s*\(")
_TRAILING_COMMENT = re.compile(r"[ \t]*/\*[^\n]*?\*/")  # a comment on the line where a declaration ends


@dataclass(frozen=True, slots=True)
class _Piece:
    """A C declaration with its comment, the names that the declaration defines, and the names that it uses."""

    comment: str
    code: str
    names: frozenset[str]
    uses: frozenset[str]

    @property
    def function(self) -> bool:
        return self.code.endswith("}")


def excerpt(sources: Iterable[Path], wanted: Iterable[str], prefix: str) -> str:
    """Return the C text of the declarations of the names in `wanted` and of all names that these declarations use.

    Raise `KeyError` if no source defines one of the names in `wanted`.

    Parameters
    ----------
    sources
        C files, each after the files that it includes.
    wanted
        Names of the C functions or types to export.
    prefix
        Prefix of every name in the result: ``kalman`` turns ``law_biquad_run`` into ``kalman_biquad_run``.
    """
    pieces = [piece for path in sources for piece in _split_declarations(path.read_text(encoding="utf-8"))]
    where = {name: piece for piece in pieces for name in piece.names}
    needed: set[_Piece] = set()
    waiting = [where[name] for name in wanted]
    while waiting:
        piece = waiting.pop()
        if piece not in needed:
            needed.add(piece)
            waiting += [where[name] for name in piece.uses if name in where]
    kept = [piece for piece in pieces if piece in needed]
    text = "\n".join(f"{piece.comment}{_make_static(piece)}\n" for piece in kept)
    return _rename_all(text, kept, prefix)


def renamed(name: str, prefix: str) -> str:
    """Return the name in an `excerpt` of a C name: ``law_biquad`` becomes ``kalman_biquad`` with prefix ``kalman``."""
    # A name that begins with the prefix already does not get it twice: law_kalman_run is kalman_run, not
    # kalman_kalman_run.
    capital = name.isupper()
    bare = name[4:] if name.startswith(("law_", "LAW_")) else name
    before = prefix.upper() if capital else prefix
    return bare if bare == before or bare.startswith(f"{before}_") else f"{before}_{bare}"


def _make_static(piece: _Piece) -> str:
    return f"static {piece.code}" if piece.function and not piece.code.startswith("static ") else piece.code


def _rename_all(text: str, pieces: Iterable[_Piece], prefix: str) -> str:
    """Return the C text with renamed functions and types; a function is renamed only before a parenthesis."""
    functions = {name for piece in pieces if piece.function for name in piece.names}
    others = {name for piece in pieces if not piece.function for name in piece.names}
    patterns = [rf"\b(?:{'|'.join(sorted(functions))})\b(?=\s*\()"] if functions else []
    patterns += [rf"\b(?:{'|'.join(sorted(others))})\b"] if others else []
    return re.sub("|".join(patterns), lambda found: renamed(str(found[0]), prefix), text)


def _split_declarations(text: str) -> Iterator[_Piece]:
    """Yield the declarations of a C file, except prototypes and preprocessor lines at the outermost level."""
    start = depth = 0
    for mark in _TOKEN.finditer(text):
        word = mark[0]
        if word.lstrip().startswith("#"):
            if depth == 0:  # a comment above it is about the file
                start = mark.end()
            continue
        depth += {"{": 1, "}": -1}.get(word, 0)
        if depth != 0 or word not in (";", "}"):
            continue
        beside = _TRAILING_COMMENT.match(text, mark.end())
        end = beside.end() if beside else mark.end()
        whole = text[start:end].strip()
        code = _COMMENT.sub("", whole).strip()
        if word == "}" and _continues(code):
            continue
        start = end
        if word == ";" and _is_prototype(code):
            continue
        names = _defined_names(code)
        used = frozenset(_NAME.findall(code)) - names
        at = whole.index(code.split(maxsplit=1)[0], _comment_length(whole))
        yield _Piece(whole[:at], whole[at:], names, used)


def _comment_length(whole: str) -> int:
    found = re.match(r"(?:\s*/\*.*?\*/)*", whole, re.DOTALL)
    return found.end() if found else 0


def _continues(code: str) -> bool:
    """Return True if a declaration continues after its closing brace, as C types and initialised objects do."""
    return code.startswith(("typedef", "enum", "struct")) or "=" in code.partition("{")[0]


def _is_prototype(code: str) -> bool:
    return not code.startswith(("typedef", "enum")) and "=" not in code and "(" in code


def _defined_names(code: str) -> frozenset[str]:
    if not code.startswith(("typedef", "enum")):
        found = _FUNCTION.search(code) if code.endswith("}") else _NAME.search(_last_name(code))
        return frozenset({found[found.lastindex or 0]} if found else ())
    names = set(re.findall(r"(?:\{|,)\s*([A-Za-z_]\w*)", code)) if "enum" in code.partition("{")[0] else set()
    if code.startswith("typedef"):
        names |= set(re.findall(r"([A-Za-z_]\w*)\s*(?:\[[^;]*\])?;$", code))
    return frozenset(names)


def _last_name(code: str) -> str:
    return str(_NAME.findall(code.partition("=")[0].partition("[")[0])[-1])
