"""What the README shows must run as it stands."""

import re
from pathlib import Path
from typing import Any

import pytest

import rig

README = Path(__file__).parents[2] / "README.md"


EXAMPLES = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)


def said_by(example: Any, directory: Any, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> Any:
    monkeypatch.chdir(directory)
    exec(compile(example, "README.md", "exec"), {})
    return capsys.readouterr().out.split()


def test_the_example_with_a_law_of_ones_own_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said = said_by(EXAMPLES[0], tmp_path, monkeypatch, capsys)
    assert said[0] in {"stable", "limit"}
    assert "N·m" in said
    assert list(tmp_path.glob("recordings/*.parquet"))


def test_the_example_of_the_theory_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.toml").write_text('preset = "koul-rigid"\n')
    said = said_by(EXAMPLES[1], tmp_path, monkeypatch, capsys)
    assert 500.0 < float(said[0]) < 700.0
    assert 0.9 < float(said[-1]) < 1.1


def test_every_public_name_of_rig_is_there() -> None:
    for name in rig._LAZY:
        assert getattr(rig, name) is not None
    assert set(rig._LAZY) <= set(dir(rig))


def test_files_that_the_readme_links_to_exist() -> None:
    for target in re.findall(r"\]\(([^)#:]+)\)", README.read_text(encoding="utf-8")):
        assert (README.parent / target).exists(), target


def test_the_public_face_takes_paths_as_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    experiment = rig.override(
        rig.load_preset("koul-compliant"), {"trial.duration_s": 0.25, "verdict.tail_s": 0.1}
    )
    for output in ("here", Path("there")):
        (result,) = rig.hit(rig.HitRequest(experiment=experiment, output=output))
        assert result.recording.parent == Path(output)
    assert rig.open_recording(str(result.recording)).complete
    assert rig.export(str(result.recording), "hit.csv").exists()
    Path("mine.toml").write_text('preset = "koul-rigid"\n')
    assert rig.load_experiment("mine.toml") == rig.load_experiment(Path("mine.toml"))
