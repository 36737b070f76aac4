"""The directory for cached files on each operating system."""

import os
from types import SimpleNamespace

import pytest

from rig.realtime import _user_cache as user_cache

HOME = os.path.expanduser("~")


@pytest.mark.parametrize(
    ("platform", "environment", "place"),
    [
        ("win32", {"LOCALAPPDATA": "/data/local"}, "/data/local"),
        ("win32", {}, f"{HOME}/AppData/Local"),
        ("darwin", {"LOCALAPPDATA": "/data/local", "XDG_CACHE_HOME": "/cache"}, f"{HOME}/Library/Caches"),
        ("linux", {"XDG_CACHE_HOME": "/cache"}, "/cache"),
        ("linux", {}, f"{HOME}/.cache"),
    ],
)
def test_each_system_has_its_place(
    platform: str, environment: dict[str, str], place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("LOCALAPPDATA", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(user_cache, "sys", SimpleNamespace(platform=platform))
    assert user_cache.user_cache() == place
