"""Write a paragraph for a paper: where linear theory and simulated hits differ, and why.

The sentences are in ``disagreement.j2``.
"""

from rig.core.sample import unit_of
from rig.extras.papers.disagreement.ablation import FINER, FOUR
from rig.extras.papers.disagreement.disagreement import Disagreement
from rig.views.report import fill_text


def paragraph(found: Disagreement) -> str:
    """Return one line of text: which walls were compared, on what share theory and simulated hits differ, and why."""
    plan = found.plan
    text = fill_text(
        "extras/papers/disagreement/disagreement.j2",
        x=plan.experiment,
        plan=plan,
        found=found,
        finer=FINER,
        absent=[one for one in FOUR if not any(one in shares.differ.causes for shares in found.schemes)],
        unit=lambda quantity: unit_of(quantity, plan.experiment.rig.motion),
    )
    return " ".join(text.split())
