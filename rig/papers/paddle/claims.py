"""What the measured curves say: which numbers of the results go into which rule."""

from __future__ import annotations

from rig.papers.paddle import rules
from rig.papers.paddle.results import Paddle
from rig.papers.rules import Ruling


def rulings(paddle: Paddle) -> dict[str, Ruling]:
    """On every statement, by key."""
    curves, step, dampings = paddle.plausible_curves, paddle.scale.ratio, paddle.scale.dampings
    told = [list(paddle.told[place].values()) for place in paddle.plausible]
    return {
        "apart": rules.apart(curves, step),
        "apart-told": rules.told_apart(told, step),
        "leads": rules.leads(curves, step),
        "peak-order": rules.peak_order(curves, step),
        "widest": rules.widest(curves, dampings),
        "range-order": rules.range_order(curves, dampings),
        "above-difference": rules.above_difference(curves, step),
        "first-rise": rules.first_rise(curves, step),
        "fourth": rules.predicted({fit.left_out: (fit.predicted, fit.mean) for fit in paddle.fits}),
    }
