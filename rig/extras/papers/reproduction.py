"""Reproduce a paper: compute all numbers in one sweep, judge them by rules, and write one HTML page from templates.

Each number in a template comes from the results or from the thresholds of the rules. A template contains no digits but
those in names of figures and rates, and a test lists these.
"""

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
    """Interface (`typing.Protocol`): all sweep tasks of a reproduction, and the conversion of their results."""

    def parts(self) -> dict[str, Part]:
        """Return all tasks of the computation, by the name of their group."""

    def results(self, done: Parts) -> Any:
        """Convert the results of all tasks of the computation to one typed object."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Paper:
    """A published paper, and the functions that compute, judge, describe and draw its results.

    Attributes
    ----------
    name
        Name in one word; the paper's templates are in the folder of this name.
    quick, full
        Settings of a coarse and of a fine computation.
    plan
        Function from one of these settings to the plan of the work.
    rulings
        Function from the results to the ruling (verdict and numbers) on each claim, by the claim's key.
    words
        Function from the results to further values that the templates use, by name.
    numbers, provenance
        Functions from the results to all numbers, and to the code version, seed and settings that they come from.
    pictures
        Functions that draw the results into a file, whose ending is the format; by name of the picture.
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
        """Return the path of the paper's template with this file name."""
        return f"extras/papers/{self.name}/{name}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Reproduction:
    """Results of a finished reproduction of one paper.

    Attributes
    ----------
    title, source
        Title of the paper, and where it was published.
    claims
        Claims with their verdicts.
    numbers, provenance
        Values of the functions of these names in `Paper`; equal for the same plan and code.
    seconds, kept
        Duration of this run (s), and number of tasks that were already in the journal.
    results
        Typed results for page and pictures.
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
        """Return claims, numbers and provenance for JSON; numbers that are not finite become None."""
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
        """Return the number of claims with this status."""
        return sum(claim.status is status for claim in self.claims)


def reproduce(
    paper: Paper,
    scale: Any,
    *,
    journal: Path | None = None,
    workers: int | None = None,
    watch: Callable[[Progress], None] | None = None,
) -> Reproduction:
    """Compute and judge all claims of a paper, with the settings `scale`: `paper.full` or `paper.quick`.

    `journal` is a file of finished results, from which a stopped reproduction resumes; `workers` the number of
    processes; `watch` receives the progress. Raises `SweepStoppedError` if the operator pressed Ctrl-C; finished
    results stay in the journal.
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
    """Return the HTML report; `pictures` has PNG data by name, and the report mentions pictures that are missing."""
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
    """Draw every picture of the report; return PNG data by name, without pictures that failed.

    `on_failure` receives the error and the name of a picture that fails; None: the error is raised.
    """
    with scratch(found.paper.name) as place:
        paths = draw_into(found, place, "png", on_failure)
        return {name: path.read_bytes() for name, path in paths.items()}


def draw_into(
    found: Reproduction, directory: Path, ending: str, on_failure: OnFailure | None = None
) -> dict[str, Path]:
    """Draw every picture into a file ``PAPER-PICTURE.ENDING`` of a directory; return the paths by name of the picture.

    The error of a picture that fails is passed to `on_failure` with the picture's name; it is raised without
    `on_failure`.
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
    """Write the HTML report and the JSON file with all numbers into a directory; return the paths of both.

    Raise `RecordingError` if a file cannot be written. `on_failure` receives the error and the name of a picture that
    fails; None: the error is raised.
    """
    page = render(found, draw(found, on_failure)).encode()
    numbers = json.dumps(found.as_mapping(), ensure_ascii=False, allow_nan=False, indent=1).encode()
    paths = directory / f"{found.paper.name}.html", directory / f"{found.paper.name}.json"
    for path, content in zip(paths, (page, numbers), strict=True):
        with whole_file(path, overwrite=True) as file:
            file.write(content)
    return paths
