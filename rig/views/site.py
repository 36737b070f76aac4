"""Build the site of documents with Sphinx, from the sources in ``rig/docs`` and the tables of the installed package.

Sphinx executes the scripts of the gallery, so it runs in a separate process on a copy of the sources. `rig serve docs`
and `rig.docs.made` call it. It must not import Sphinx into this process.
"""

import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from rig.core.child import with_this_package
from rig.core.errors import ConfigError, RecordingError, RigError
from rig.core.present import Item, Row

SOURCES = Path(__file__).parents[1] / "docs"
NEEDED = ("sphinx", "myst_parser", "furo", "sphinx_gallery", "sphinx_design")  # the extra `docs`
_SHOWN_LINES = 20  # of what Sphinx complains about


@dataclass(frozen=True, slots=True)
class Site:
    """A built site: path of its first page, number of pages, duration of the build (s), and what Sphinx warned of."""

    index: Path
    pages: int
    seconds: float
    warnings: tuple[str, ...]

    def items(self) -> list[Item]:
        """Return the rows that `rig serve docs` prints: path, number of pages, duration (s)."""
        return [
            Row("site", str(self.index)),
            Row("pages", self.pages),
            Row("built in", round(self.seconds, 1), "s"),
        ]


def build_site(output: Path, *, strict: bool = False) -> Site:
    """Build the site of documents into the subdirectory ``html`` of `output`; existing pages are replaced.

    With `strict`, warnings and broken links are errors. Raise `ConfigError` if the extra ``docs`` is not installed,
    `RecordingError` if the directory cannot be written, `RigError` with the end of the output if Sphinx or a script of
    the gallery fails.
    """
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise ConfigError(
            f"the documents need {', '.join(missing)}, which are not installed",
            remedy="pip install 'haptic-rig[docs]'",
        )
    began = time.monotonic()
    sources, pages = output / ".sources", output / "html"
    try:
        shutil.rmtree(sources, ignore_errors=True)
        shutil.copytree(SOURCES, sources, ignore=shutil.ignore_patterns("__pycache__"))
    except OSError as error:
        raise RecordingError(
            f"cannot write {error.filename or output}: {error.strerror or error}",
            remedy="choose another `output`",
        ) from error
    # Longer examples run the `rig` of this environment.
    commands = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    strictly = ["-n", "-W", "--keep-going"] if strict else []
    built = subprocess.run(
        [sys.executable, "-P", "-m", "sphinx", "-q", "-E", *strictly, str(sources), str(pages)],
        env=with_this_package() | {"MPLBACKEND": "Agg", "PATH": commands},
        capture_output=True,
        encoding="utf-8",
        errors="replace",
        check=False,
    )
    if built.returncode:
        messages = (built.stderr or built.stdout).strip().splitlines()[-_SHOWN_LINES:]
        raise RigError(
            "the documents were not built:\n" + "\n".join(messages), remedy="fix the errors in this output"
        )
    warnings = tuple(built.stderr.splitlines())
    return Site(pages / "index.html", len(list(pages.rglob("*.html"))), time.monotonic() - began, warnings)
