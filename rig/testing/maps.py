"""Compute the Z-width map (stable walls by stiffness and damping) for a test, in simulation or on a real rig.

The fixture ``rig_zwidth`` returns it. On a real rig it must not hit without a person's consent.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rig.config import Experiment
from rig.config.schemes import Scheme
from rig.core.errors import StoppedError
from rig.experiments.mapping import interface as maps
from rig.experiments.mapping.interface import DeviceMap, MapPlan, Next, OnDevice, ZWidth, zwidth_on_rig
from rig.testing.experiments import Experiments, Source
from rig.testing.hits import Rigs, end_all


class Maps:
    """Callable that computes the map of stable walls for a test (the fixture ``rig_zwidth``)."""

    def __init__(self, rigs: Rigs, experiments: Experiments, directory: Path) -> None:
        self._rigs, self._experiments, self._directory = rigs, experiments, directory

    def __call__(
        self,
        source: Source = None,
        changes: Mapping[str, Any] | None = None,
        *,
        schemes: Sequence[str] = (),
        dampings: Sequence[float] | None = None,
        lowest: float | None = None,
        highest: float | None = None,
        ratio: float = 1.06,
        repeats: int = 1,
    ) -> ZWidth:
        """Return a map of the walls (stiffness, damping) that are stable.

        Raise `RigError` if a run is refused or fails. On a real rig a person must agree to each hit in the terminal.

        Parameters
        ----------
        source, changes
            The experiment (preset, path ending in .toml, or object) and its changed values by dotted key.
        schemes
            Sampling schemes like ``dual:20k/2k``; if empty, the experiment's scheme and uniform schemes at its rates.
        dampings
            Damping B of each column of the map (N·m·s/rad or N·s/m); None for the default dampings.
        lowest, highest, ratio
            Lowest and highest stiffness (N·m/rad or N/m), and ratio of neighbouring stiffnesses.
        repeats
            How often the largest stable stiffness is determined at each damping, each time by hits at rising stiffness.
        """
        plan = self._plan(
            self._experiments(source, changes), schemes, dampings, lowest, highest, ratio, repeats
        )
        if self._rigs.simulated:
            return maps.zwidth(plan)
        with self._rigs.device(plan.experiment) as device:
            where = OnDevice(
                url=self._rigs.url,
                verified=self._rigs.verified,
                recordings=self._directory,
                hands_off=self._rigs.hands_off,
                device=device,
                reference_count=self._rigs.zero(plan.experiment) or 0,
            )
            try:
                return zwidth_on_rig(plan, DeviceMap(where=where, agrees=self._agrees))
            except StoppedError as stopped:
                end_all(stopped)

    def _plan(
        self,
        experiment: Experiment,
        schemes: Sequence[str],
        dampings: Sequence[float] | None,
        lowest: float | None,
        highest: float | None,
        ratio: float,
        repeats: int,
    ) -> MapPlan:
        on_device = not self._rigs.simulated
        chosen = [Scheme.parse(text) for text in schemes]
        search = maps.search_for(
            experiment, ratio=ratio, lowest=lowest, highest=highest, schemes=chosen, on_device=on_device
        )
        return maps.hit_plan(
            experiment,
            chosen,
            dampings=dampings,
            search=search,
            repeats=repeats,
            on_device=on_device,
        )

    def _agrees(self, asked: Next) -> bool:
        return self._rigs.ask(
            f"{asked.scheme}, B = {asked.damping:.4g}, K = {asked.stiffness:.4g}, hit {asked.number} of series "
            f"{asked.series} of {asked.total}"
        )
