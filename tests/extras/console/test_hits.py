"""Hits that a page starts."""

from pathlib import Path

import pytest

from rig.core.errors import PlanError
from rig.extras.console import hits
from rig.extras.console.talk import Talk
from tests.conformance.gated import REFUSED, open_behind_a_slow_link


def test_a_page_asks_the_gate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    open_behind_a_slow_link(monkeypatch)
    changes = {"host.realtime": "off", "trial.minimum_rest_counts": 0.0}
    content = {"url": "serial:///dev/rig", "verified": True, "output": str(tmp_path), "changes": changes}
    with pytest.raises(PlanError, match=REFUSED):
        hits.hit(content, Talk(goes_on=False))
