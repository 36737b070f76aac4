"""The claims of Chawda et al. with their verdicts: which numbers of the results go into which rule."""

from __future__ import annotations

from rig.papers.chawda import claims_fidelity as fidelity
from rig.papers.chawda import claims_hits as hits
from rig.papers.chawda import claims_table as table
from rig.papers.chawda import claims_widths as widths
from rig.papers.chawda.results import Chawda
from rig.papers.frame import Claim


def claims(chawda: Chawda) -> tuple[Claim, ...]:
    """Every claim with its verdict."""
    return (
        hits.claim_regions(),
        hits.claim_stiffer_levant(chawda),
        hits.claim_stiffer_below(chawda),
        hits.claim_filter_holds(chawda),
        hits.claim_limited(chawda),
        hits.claim_sharp(chawda),
        hits.claim_where_it_drops(chawda),
        widths.claim_order(chawda),
        widths.claim_levant_stiffest(chawda),
        widths.claim_akf_over_fdm(chawda),
        widths.claim_fdm_over_foaw(chawda),
        widths.claim_damping_width(chawda),
        fidelity.claim_lowest_error(chawda),
        fidelity.claim_common_error(chawda),
        fidelity.claim_error_grows(chawda),
        table.claim_widths(chawda),
        table.claim_errors(chawda),
        table.claim_both(chawda),
        table.claim_wider(chawda),
        table.claim_search(chawda),
        table.claim_undamped(chawda),
        table.claim_bare(chawda),
    )
