"""What the tests of commands share."""

import pytest

import rig.cli


@pytest.fixture
def run(capfd, tmp_path, monkeypatch):
    """Run a command line in an empty directory: exit code, standard output, standard error."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        code = rig.cli.run([str(argument) for argument in arguments])
        out, err = capfd.readouterr()
        assert "Traceback" not in err
        return code, out, err

    return call
