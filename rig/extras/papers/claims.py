"""Read the claims of a paper from a template, and add to each claim its ruling (verdict and the numbers behind it).

A paper's ``claims.j2`` has a section for each claim. Every number in it comes from the ruling or from the thresholds
of the rules; all other text is edited in the template, without changing Python.

::

    [paper]
    title: …
    source: …

    [rises]                      the key of the claim
    claim: what the paper says
    paper: the paper's number
    ours: the number of this project
    only with: a condition       replaces the names of the cases in which the claim held (optional)
    in part: what is reproduced  if the rule can judge "reproduced in part"
    needs: what the claim depends on, as far as this project knows
    rule: how the verdict follows from the numbers
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rig.core.present import reported
from rig.extras.papers.rules import ClaimStatus, Ruling
from rig.views.report import fill_text

HEAD = re.compile(r"\[([\w-]+)\]")
BEGIN = re.compile(r"(title|source|claim|paper|ours|only with|in part|needs|rule): *(.*)")


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """A claim of the paper, this project's numbers, the verdict, and what it depends on: a row of the report."""

    key: str
    claim: str
    paper: str
    ours: str
    status: ClaimStatus
    condition: str
    needs: str
    rule: str

    @reported
    def verdict(self) -> str:
        """Return the status and its condition as text, such as "reproduced only with 10 bits"."""
        return f"{self.status} {self.condition}".rstrip()


def read_claims(
    template: str, rulings: Mapping[str, Ruling], words: Mapping[str, Any]
) -> tuple[Mapping[str, str], tuple[Claim, ...]]:
    """Fill a template of claims; return title and source of the paper, and its claims in the order of `rulings`.

    A ruling is a verdict with its numbers; `words` are further values for the template. Raise `KeyError` if a claim has
    no text or no ruling.
    """
    texts = _sections(fill_text(template, rulings=rulings, **words))
    paper = texts.pop("paper")
    if extra := set(texts) ^ set(rulings):
        raise KeyError(
            f"{template}: claims with a text but no ruling, or with a ruling but no text: {', '.join(sorted(extra))}; "
            "give every claim a section in the template and a ruling in claims.py"
        )
    return paper, tuple(_claim(key, ruling, texts[key]) for key, ruling in rulings.items())


def _sections(text: str) -> dict[str, dict[str, str]]:
    found: dict[str, dict[str, str]] = {}
    key = name = ""
    for line in text.splitlines():
        if head := HEAD.fullmatch(line):
            key = head[1]
            found[key] = {}
        elif begin := BEGIN.match(line):
            name = begin[1]
            found[key][name] = begin[2]
        elif line.strip():
            found[key][name] += f" {line}"
    return {key: {name: " ".join(of.split()) for name, of in texts.items()} for key, texts in found.items()}


def _claim(key: str, ruling: Ruling, texts: Mapping[str, str]) -> Claim:
    condition = ""
    if ruling.status is ClaimStatus.ONLY_WITH:
        condition = texts.get("only with", ruling.condition)
    elif ruling.status is ClaimStatus.PARTLY:
        condition = texts["in part"]
    return Claim(
        key=key,
        status=ruling.status,
        condition=condition,
        **{name: texts[name] for name in ("claim", "paper", "ours", "needs", "rule")},
    )
