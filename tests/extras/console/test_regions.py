"""The limits of linear theory beside a slider: a passive limit of zero, and one that theory does not compute."""

from rig.config import override, presets
from rig.extras.console.regions import regions


def test_a_passive_limit_that_theory_does_not_compute_differs_from_zero() -> None:
    experiment = presets.load("koul-compliant")
    assert regions(experiment, 1, 0.2).passive == 0.0
    by_effort = regions(override(experiment, {"controller.estimator": "disturbance"}), 1, 0.2)
    assert by_effort.passive is None
    assert by_effort.stable is not None
    assert "no theory with the effort" in by_effort.note
