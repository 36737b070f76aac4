"""File locks between openings and between processes."""

from pathlib import Path

from rig.core.locks import is_locked, lock, unlock


def test_a_lock_has_one_holder_until_release_or_close(tmp_path: Path) -> None:
    path = tmp_path / "file"
    with open(path, "ab") as first, open(path, "ab") as second:
        assert not is_locked(path)
        assert lock(first.fileno())
        assert is_locked(path)
        assert not lock(second.fileno())
        unlock(first.fileno())
        assert not is_locked(path)
        assert lock(second.fileno())
    assert not is_locked(path)
    assert not is_locked(tmp_path / "none")
