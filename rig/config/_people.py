"""Set and check limits for people: limits of a trial in which a person holds the handle (``trial.kind = "human"``).

The effort is at most ``nominal_effort``, and violent oscillations end the trial (`rig.control._watch`). The loader of
experiments calls it.
"""

from collections.abc import Collection
from dataclasses import replace

from rig.config._derive import press_for, push_at_rest
from rig.config._sections import OSCILLATIONS, Experiment

# of the effort limit: a press swells by a fifth, and a count deeper must not reach the limit
PRESS_SHARE = 0.6
# Stiffness of a wall (N·m/rad or N/m) that hardly yields: a press computed for it is safe for every softer wall.
HARD = 1e12


def with_human_limits(experiment: Experiment, meant: Collection[str]) -> Experiment:
    """Return the experiment with the limits for people, if the user has set ``trial.kind`` to "human".

    `meant` contains the keys that the user has set. Their values are not changed here, but checked later, by
    `rig.config._rules` and `human_limits_exceeded`. If the lower effort limit requires it, a simulated hand presses
    less.
    """
    limits = experiment.rig.limits
    if experiment.trial.kind != "human" or "rig.limits.human" in meant:
        return experiment
    if "trial.kind" in meant:
        effort = limits.effort
        # The file that these limits come from has an effort that overrides a stall.
        stalls = limits.override_stall and "rig.limits.override_stall" not in meant
        if not stalls and "rig.limits.effort" not in meant:
            effort = min(effort, limits.nominal_effort)
        limits = replace(limits, human=True, effort=effort)
        experiment = replace(experiment, rig=replace(experiment.rig, limits=limits))
    presses = {"trial.kind", "operator.grip"} & set(meant) and "operator.press" not in meant
    if presses and limits.human and push_at_rest(experiment) > limits.effort:
        hard = replace(experiment, wall=replace(experiment.wall, stiffness=HARD))
        press = press_for(hard, PRESS_SHARE * limits.effort)
        if press >= 0.0:
            experiment = replace(experiment, operator=replace(experiment.operator, press=press))
    return experiment


def human_limits_exceeded(experiment: Experiment) -> list[str]:
    """Return a text ``key = value`` for each key that exceeds the limits for people; a real rig refuses the trial."""
    limits = experiment.rig.limits
    if experiment.trial.kind != "human":
        return []
    exceeded = [] if limits.human else ["rig.limits.human = false"]
    if not limits.human and not limits.override_stall and limits.effort > limits.nominal_effort:
        exceeded.append(
            f"rig.limits.effort = {limits.effort:g} (at most {limits.nominal_effort:g} for people)"
        )
    if limits.oscillations is not None and not 0 < limits.oscillations <= OSCILLATIONS:
        exceeded.append(f"rig.limits.oscillations = {limits.oscillations} (1 to {OSCILLATIONS} for people)")
    return exceeded
