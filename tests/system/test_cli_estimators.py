"""`rig estimators list` prints what each estimator's own record contains."""

from typing import Any

from rig.control import estimators


def test_list_shows_every_estimator_with_its_parameters_delay_and_source(run: Any) -> None:
    code, out, _ = run("estimators", "list")
    assert code == 0
    for name in estimators.names():
        each = estimators.get(name)
        assert f"{name}: {each.summary}" in out
        assert each.source in out
        for setting in each.settings:
            assert setting.name in out
            assert setting.meaning in out
    assert "200 Hz   (0.1 to 1e+06) -3 dB frequency" in out
    assert "1.338 ms at 2000 Hz" in out
