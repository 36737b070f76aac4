"""Command ``rig theory limit-cycles``: predict and simulate the limit cycles of the encoder's quantisation."""

from pathlib import Path

from rig import config
from rig.cli import options, output
from rig.cli.command import command
from rig.config.schemes import Scheme
from rig.core.errors import ConfigError
from rig.core.present import plain
from rig.experiments.mapping.interface import numbers_of
from rig.extras.papers.disagreement.limit_cycles import limit_cycles as compare


@command("limit-cycles")
@options.file_argument
@options.rig_option()
@options.walls_options(
    "Stiffnesses of the walls. [¼, ½ and ¾ of K_max by linear theory]",
    "Dampings of the walls, with --stiffness. [0, ¼, ½ and ¾ of B_max]",
)
@options.scheme_option("the experiment's and the uniform ones of its rates")
@options.set_option
@options.json_option
def limit_cycles(
    file: Path | None,
    preset: str | None,
    stiffness: str | None,
    damping: str | None,
    schemes: tuple[str, ...],
    cutoff: str | None,
    sets: tuple[str, ...],
    as_json: bool,
) -> None:
    """Predict how the encoder's quantisation makes walls oscillate, by describing functions, and simulate these walls.

    Prints amplitude (counts) and frequency, predicted and simulated, with and without Coulomb friction. A constant push
    holds the handle half-way between two counts, where walls oscillate most; no hand holds it.
    `rig.theory.limit_cycle` predicts one wall in a few milliseconds.
    """
    if (stiffness is None) != (damping is None):
        raise ConfigError("only one of --stiffness and --damping is given", remedy="give both, or neither")
    experiment = config.override(
        options.chosen_experiment(file, preset), options.changes(None, sets, cutoff=cutoff)
    )
    walls = (
        None
        if stiffness is None or damping is None
        else [(k, b) for b in numbers_of(damping, "--damping") for k in numbers_of(stiffness, "--stiffness")]
    )
    found = compare(experiment, [Scheme.parse(text) for text in schemes], walls)
    if as_json:
        output.print_json(plain(found))
    else:
        output.show(found.detailed())
