"""What our lab promises of its walls."""

from pathlib import Path

import numpy as np
import pytest
from mylab.velocity import alpha_beta
from mylab.walls import detent

import rig
from rig.testing import check_estimator, check_law, reactions


def test_our_law_and_our_estimator_keep_the_promises() -> None:
    check_law(detent)
    check_law("detent", stiffness=50.0)
    check_estimator(alpha_beta)
    check_estimator("alpha-beta", {"bandwidth_hz": 50.0})


def test_each_click_takes_its_share_of_the_spring() -> None:
    depth = np.array([0.0015, 0.0025, 0.0045])
    found = reactions(detent.with_parameters(share=1.0), depth, stiffness=100.0)
    assert found == pytest.approx([0.15, 0.05, 0.05])


def test_the_wall_is_hit_by_its_name(tmp_path: Path) -> None:
    result = rig.hit(
        "koul-compliant",
        law="detent",
        estimator="alpha-beta",
        stiffness=100.0,
        duration_s=0.6,
        output=tmp_path,
    )
    assert result.verdict.kind in {"stable", "limit cycle"}
    position = result.recording["position"]
    assert position.unit == "rad"
    assert position.values.max() > 0.0
    assert rig.replay(result.path).exact


def test_a_map_of_it_is_kept(tmp_path: Path) -> None:
    found = rig.zwidth(
        "koul-compliant",
        ["dual:20k/2k,estimator=alpha-beta"],
        law="detent",
        dampings=[0.5],
        lowest=50.0,
        highest=60.0,
        search="bisection",
        ratio=1.1,
        offsets=[0.1],
        directory=tmp_path,
    )
    assert found.hits >= 2
    assert list(tmp_path.glob("*/map.json"))
