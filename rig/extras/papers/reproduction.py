"""A reproduction: everything computed as one sweep, judged by rules, worded by templates, written as one HTML page.

A number in a template comes from the results or from the thresholds of the rules: a template holds no digits but the
names of figures and rates, and a test lists these.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from rig.core.present import plain
from rig.core.scratch import scratch
from rig.experiments.sweep import Progress
from rig.extras.papers.claims import Claim, read_claims
from rig.extras.papers.parts import Part, Parts, run_parts
from rig.extras.papers.rules import ClaimStatus, Ruling
from rig.recording.files import whole_file
from rig.views.report import data_uris, fill, provenance_lines

OnFailure = Callable[[Exception, str], None]
CLAIMS, PAGE = "claims.j2", "page.html.j2"  # templates of a paper
# Classes of the style sheet.
MARKS = dict.fromkeys(ClaimStatus, "only") | {ClaimStatus.REPRODUCED: "yes", ClaimStatus.NOT: "no"}


class ReproductionPlan(Protocol):
    """All parts of the work, by name, and the way back from their results."""

    def parts(self) -> dict[str, Part]:
        """Return everything that has to be computed."""

    def results(self, done: Parts) -> Any:
        """Return one typed object of everything that came back."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Paper:
    """A paper, and how its results are computed, judged, worded and drawn.

    Attributes
    ----------
    name
        One word; its templates stand in that folder.
    quick, full
        How fine everything is computed.
    plan
        The work, from such a scale.
    rulings
        On every claim, by key, from the results.
    words
        What the templates call for beside rulings and claims.
    numbers, provenance
        Every number in plain values; what they come from, the same on every machine.
    pictures
        By name: a function that draws the results into a file, in the format that its name ends in.
    """

    name: str
    quick: Any
    full: Any
    plan: Callable[[Any], ReproductionPlan]
    rulings: Callable[[Any], dict[str, Ruling]]
    words: Callable[[Any], dict[str, Any]]
    numbers: Callable[[Any], dict[str, Any]]
    provenance: Callable[[Any], dict[str, Any]]
    pictures: Mapping[str, Callable[[Any, Path], None]]

    def template(self, name: str) -> str:
        """Return the path of one of its templates."""
        return f"extras/papers/{self.name}/{name}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Reproduction:
    """A finished reproduction.

    Attributes
    ----------
    title, source
        Of the paper: a line, and where it was published.
    claims
        With their verdicts.
    numbers, provenance
        As of its `Paper`; the same for the same plan and code.
    seconds, kept
        How long this run took, and how many tasks it found already done.
    results
        What page and pictures are made from.
    """

    paper: Paper
    title: str
    source: str
    claims: tuple[Claim, ...]
    numbers: Mapping[str, Any]
    provenance: Mapping[str, Any]
    seconds: float
    kept: int = 0
    results: Any = field(default=None, repr=False, compare=False)

    def as_mapping(self) -> dict[str, Any]:
        """Return plain values for JSON; numbers that are not finite become None."""
        mapping = {
            "name": self.paper.name,
            "title": self.title,
            "claims": self.claims,
            "numbers": self.numbers,
            "provenance": self.provenance,
            "seconds": self.seconds,
            "kept": self.kept,
        }
        return dict(plain(mapping))

    def count(self, status: ClaimStatus) -> int:
        """Return how many claims have this status."""
        return sum(claim.status is status for claim in self.claims)


def reproduce(
    paper: Paper,
    scale: Any,
    *,
    journal: Path | None = None,
    workers: int | None = None,
    watch: Callable[[Progress], None] | None = None,
) -> Reproduction:
    """Reproduce a paper.

    Parameters
    ----------
    paper, scale
        Which, and how fine: its `full`, or the coarse `quick`.
    journal, workers, watch
        As in `rig.experiments.sweep.run`; with a journal a stopped reproduction resumes.

    Raises
    ------
    SweepStoppedError
        Ctrl-C; what is done stays in the journal.
    """
    plan = paper.plan(scale)
    done = run_parts(plan.parts(), journal=journal, workers=workers, watch=watch)
    results = plan.results(done)
    head, claims = read_claims(paper.template(CLAIMS), paper.rulings(results), paper.words(results))
    return Reproduction(
        paper=paper,
        title=head["title"],
        source=head["source"],
        claims=claims,
        numbers=paper.numbers(results),
        provenance=paper.provenance(results),
        seconds=done.seconds,
        kept=done.kept,
        results=results,
    )


def render(found: Reproduction, pictures: Mapping[str, bytes]) -> str:
    """Return the page; a picture (PNG by name) that is not there is reported as missing."""
    return fill(
        found.paper.template(PAGE),
        reproduction=found,
        marks=MARKS,
        ClaimStatus=ClaimStatus,
        pictures=data_uris(pictures),
        provenance=provenance_lines(found.provenance),
        data=found.as_mapping(),
        sections=[],
        **found.paper.words(found.results),
    )


def draw(found: Reproduction, on_failure: OnFailure | None = None) -> dict[str, bytes]:
    """Draw every picture of the page; returns PNGs by name."""
    with scratch(found.paper.name) as place:
        paths = draw_into(found, place, "png", on_failure)
        return {name: path.read_bytes() for name, path in paths.items()}


def draw_into(
    found: Reproduction, directory: Path, ending: str, on_failure: OnFailure | None = None
) -> dict[str, Path]:
    """Draw every picture into a file of this ending, PAPER-NAME; returns their paths by name.

    A picture that fails is reported to `on_failure` with its name, and raised without it.
    """
    paths = {}
    for name, picture in found.paper.pictures.items():
        path = directory / f"{found.paper.name}-{name}.{ending}"
        try:
            picture(found.results, path)
        except Exception as error:
            if on_failure is None:
                raise
            on_failure(error, name)
        else:
            paths[name] = path
    return paths


def write_report(
    found: Reproduction, directory: Path, on_failure: OnFailure | None = None
) -> tuple[Path, Path]:
    """Write the page with its pictures, and the numbers, into a directory; returns both paths.

    `RecordingError` when the disk refuses; a picture that fails as in `draw_into`.
    """
    page = render(found, draw(found, on_failure)).encode()
    numbers = json.dumps(found.as_mapping(), ensure_ascii=False, allow_nan=False, indent=1).encode()
    paths = directory / f"{found.paper.name}.html", directory / f"{found.paper.name}.json"
    for path, content in zip(paths, (page, numbers), strict=True):
        with whole_file(path, overwrite=True) as file:
            file.write(content)
    return paths
