"""The hits that a page can start."""

from pathlib import Path

import pytest

from rig.core.errors import PlanError
from rig.extras.console import hits
from rig.extras.console.talk import Talk
from tests.conformance.gated import REFUSED, SLOW_S, open_as_real


def test_a_page_asks_the_gate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    open_as_real(monkeypatch, SLOW_S)
    changes = {"host.realtime": "off", "trial.minimum_rest_counts": 0.0}
    content = {"url": "serial:///dev/rig", "verified": True, "output": str(tmp_path), "changes": changes}
    with pytest.raises(PlanError, match=REFUSED):
        hits.hit(content, Talk(is_detached=False))
