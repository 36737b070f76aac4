"""What the README shows must run as it stands."""

import re
from pathlib import Path

import rig

README = Path(__file__).parents[2] / "README.md"


def test_the_python_example_runs(tmp_path, monkeypatch, capsys):
    (example,) = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "README.md", "exec"), {})
    said = capsys.readouterr().out.split()
    assert said[0] in {"stable", "limit"}
    assert "N·m" in said
    assert list(tmp_path.glob("recordings/*.parquet"))


def test_every_public_name_of_rig_is_there():
    for name in rig._LAZY:
        assert getattr(rig, name) is not None
    assert set(rig._LAZY) <= set(dir(rig))


def test_files_that_the_readme_links_to_exist():
    for target in re.findall(r"\]\(([^)#:]+)\)", README.read_text(encoding="utf-8")):
        assert (README.parent / target).exists(), target
