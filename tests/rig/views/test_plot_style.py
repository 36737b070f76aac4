"""Properties of all pictures: formats by file ending, axes of almost equal values."""

import ast
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import matplotlib
import pytest

import rig
from rig.core.errors import RecordingError
from rig.core.shown import Picture
from rig.views.plots import style
from tests.conformance.tiers import first_by_default
from tests.rig.views.conftest import a_figure

BEGINS = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}


@pytest.mark.parametrize("ending", first_by_default(style.FORMATS))
def test_the_name_chooses_the_format_and_a_picture_has_the_same_bytes(ending: str, tmp_path: Path) -> None:
    first, second = (
        style.save(a_figure(), tmp_path / name).read_bytes()
        for name in (f"a.{ending}", f"b.{ending.upper()}")
    )
    assert first.startswith(BEGINS[ending])
    assert first == second
    text = {"svg": "K_max (N·m/rad)".encode(), "pdf": b"/FontFile2"}  # text, not drawn outlines
    assert text.get(ending, b"") in first


OUTSIDE = """
text.usetex: True
font.size: 31
axes.grid: True
lines.linewidth: 9
savefig.bbox: tight
svg.fonttype: path
figure.facecolor: black
"""


@pytest.mark.exhaustive("::test_every_function_that_makes_a_figure_draws_in_the_style_of_this_package")
def test_style_latex_and_backend_of_others_change_no_byte_and_stay_as_they_were(tmp_path: Path) -> None:
    """A lab's matplotlibrc, a notebook's style, and a notebook's backend that is not installed here."""
    plain = style.save(a_figure(), tmp_path / "plain.svg").read_bytes()
    (tmp_path / "matplotlibrc").write_text(OUTSIDE)
    imported = "from pathlib import Path; from tests.rig.views.conftest import a_figure, style"
    drawing = f"{imported}; style.save(a_figure(), Path('theirs.svg'))"
    no_window = "import sys; assert not {'matplotlib.pyplot', 'tkinter'} & set(sys.modules)"
    backend = "module://matplotlib_inline.backend_inline"
    environment = {
        **os.environ,
        "PYTHONPATH": str(Path(__file__).parents[3]),
        "MPLBACKEND": backend,
        "DISPLAY": "",
    }
    begun = f"from rig.core import program; program.begin(); {drawing}; {no_window}"
    options: Any = {"cwd": tmp_path, "env": environment, "capture_output": True, "text": True}
    done = subprocess.run([sys.executable, "-c", begun], check=False, **options)
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "theirs.svg").read_bytes() == plain
    with matplotlib.rc_context({"font.size": 31.0, "text.usetex": True, "axes.grid": True}):
        before = dict(matplotlib.rcParams)
        assert style.save(a_figure(), tmp_path / "here.svg").read_bytes() == plain
        assert Picture(a_figure())._repr_png_().startswith(BEGINS["png"])
        assert dict(matplotlib.rcParams) == before


def test_pictures_that_two_threads_draw_at_once_leave_the_settings_of_the_user(tmp_path: Path) -> None:
    with matplotlib.rc_context({"font.size": 31.0}), ThreadPoolExecutor(2) as threads:
        list(threads.map(lambda number: style.save(a_figure(), tmp_path / f"{number}.svg"), range(2)))
        assert matplotlib.rcParams["font.size"] == 31.0


def test_every_function_that_makes_a_figure_draws_in_the_style_of_this_package() -> None:
    """Texts use the settings at their creation, so an undecorated function would use those of the user."""
    package = Path(rig.__file__).parent
    files = [*(package / "views/plots").glob("*.py"), *(package / "extras").rglob("*.py")]
    makers = [
        (path.name, function.name, {ast.unparse(one) for one in function.decorator_list})
        for path in files
        if "style.new_figure(" in path.read_text("utf-8")
        for function in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(function, ast.FunctionDef) and "style.new_figure(" in ast.unparse(function)
    ]
    assert len(makers) > 10
    assert [(file, name) for file, name, decorators in makers if "style.own_style()" not in decorators] == []


def test_a_matplotlib_that_does_not_load_is_an_error_with_a_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails() -> None:
        raise ValueError("Key backend: 'module://x' is not a valid value for backend")

    monkeypatch.setattr(style, "matplotlib", SimpleNamespace(rc_context=fails))
    with pytest.raises(RecordingError, match="matplotlib cannot be imported: Key backend") as caught:
        a_figure()
    assert "unset MPLBACKEND" in caught.value.remedy


@pytest.mark.parametrize("name", ["\udcff.png", "\udcff.svg"])
def test_a_name_that_is_no_text_can_be_written_and_drawn(name: str, tmp_path: Path) -> None:
    assert style.save(a_figure("\udcff"), tmp_path / name).stat().st_size > 1000


def test_a_place_that_cannot_be_written_is_an_error_with_a_remedy(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"cannot write the picture .*nowhere") as caught:
        style.save(a_figure(), tmp_path / "nowhere" / "x.png")
    assert caught.value.remedy
    assert not (tmp_path / "nowhere").exists()


@pytest.mark.parametrize("name", ["a.jpg", "a", "a.png.rigcap", "a.parquet", ".png"])
def test_no_other_name_is_written(name: str, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"does not end in a format of pictures") as caught:
        style.save(a_figure(), tmp_path / name)
    assert ".png, .svg, .pdf" in caught.value.remedy
    assert list(tmp_path.iterdir()) == []


# ------------------------------------------------------------------------------------------------------------ axes


@pytest.mark.parametrize("values", [[500.0, 500.0 + 1e-11], [500.0], [0.0, 1e-14], []])
def test_values_that_are_alike_are_not_spread_over_an_axis(values: Any) -> None:
    axes = style.new_figure().subplots()
    axes.plot(range(len(values)), values, "o")
    style.at_least(axes, "y", 50.0)
    low, high = axes.get_ylim()
    assert high - low >= 50.0 * (1.0 - 1e-12)
    assert all(low < value < high for value in values)
