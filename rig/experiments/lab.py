"""Functions for the user: an experiment by a preset's name, as a file or loaded, settings by name, and one result.

Everything here adapts arguments and hands them to the functions that commands call too.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any, Literal, Unpack

from rig import config
from rig.config import DEFAULT_PRESET, Experiment, controller, presets
from rig.config.schemes import Scheme
from rig.control import estimators, laws
from rig.control.estimators import Estimator
from rig.control.laws import Law
from rig.core import plugins
from rig.core.errors import ConfigError
from rig.devices.framed import FramedDevice
from rig.experiments import design as designing
from rig.experiments import sweep
from rig.experiments.hits import compare as comparing
from rig.experiments.hits import hit as one_hit
from rig.experiments.hits.admission import admit
from rig.experiments.hits.compare import OFFSETS, SchemeComparison, entries_of, refuse_unused
from rig.experiments.hits.hit import HitRequest, HitResult, Watch
from rig.experiments.mapping import _maps as maps
from rig.experiments.mapping._ranges import hit_plan, schemes_for, search_for
from rig.experiments.mapping._searches import Way
from rig.experiments.mapping.zwidth import Judged, ZWidth
from rig.experiments.trials import plan as planning
from rig.experiments.trials import replay as replaying
from rig.experiments.trials.planned import Plan
from rig.experiments.trials.replay import ReplayResult
from rig.experiments.trials.settings import HitSettings, Settings, WallSettings, changes_of, takes
from rig.realtime import stop_requests
from rig.recording.data import Recording
from rig.recording.reader import open_recording

ExperimentLike = str | Path | Experiment
"""A preset's name, the path of a file, or an experiment."""


class HitOptions(HitSettings, total=False):
    """Keywords of `hit`: settings, and fields of a `HitRequest`, with their types there."""

    law: str | Law
    estimator: str | Estimator
    url: str
    device: FramedDevice
    realtime: bool
    verified: bool
    arm_anyway: bool
    hands_off: Callable[[str], None]
    output: str | Path
    name: str


@takes(WallSettings)
def load(experiment: ExperimentLike, **settings: Unpack[WallSettings]) -> Experiment:
    """Load an experiment, with some of its keys changed.

    Parameters
    ----------
    experiment
        A preset's name (``"koul-compliant"``), the path of a file (it ends in ``.toml`` or has a slash), or an
        experiment.
    **settings
        In SI units of the rig: ``stiffness=100.0``; any other key by ``changes={"wall.position": 0.1}``.
        `operator` is who pushes: the grip of a simulated hand (relaxed, normal, firm), or none: the motor.

    Raises
    ------
    ConfigError
        No such preset or file, no such setting, or values that cannot be: each with key, range and remedy.
    """
    return _change(experiment, changes_of(settings, WallSettings))


@takes(HitOptions, HitRequest)
def hit(
    experiment: ExperimentLike = DEFAULT_PRESET, watch: Watch | None = None, **options: Unpack[HitOptions]
) -> HitResult:
    """Hit a wall once: home, push into it, judge, record.

    Parameters
    ----------
    experiment
        As in `load`.
    watch
        Called before the hit with its number, 0, and the experiment in effect; may return a function that is called
        with (ticks, phase) while it runs.
    **options
        Settings as in `load`, and: `law`, `estimator` (a name, or one of your own); an open `device` instead of a
        `url`; `hands_off`, called before a torque pulse at which no hand may hold a real rig (prints a line to standard
        error unless given); the `name` of the recording.

    Raises
    ------
    ConfigError, PlanError
        Something that cannot or must not run: nothing has moved.
    RigError
        Whatever ended the hit early; the effort is zero, and `recording` of the error names what was recorded.
    """
    given: dict[str, Any] = {"hands_off": _print_message, **options}
    changes, loaded = changes_of(options, HitOptions), presets.load_named(experiment)
    repeats = changes.get("trial.repeats", loaded.trial.repeats)
    if repeats != 1:
        raise ConfigError(
            f"trial.repeats = {repeats!r}: this function returns a single result, so it must be 1",
            remedy="give repeats=1, and call it in a loop; for several hits of one device, pass the "
            "open device",
        )
    law, estimator = _take_own_parts(given, changes)
    own = {one.name: given[one.name] for one in fields(HitRequest) if one.name in given}
    request = HitRequest(**{**own, "experiment": loaded, "changes": changes, "law": law})
    with _register(law, estimator):
        (result,) = one_hit.hit(request, admit, watch)
    return result


def stop() -> int:
    """Stop every run of this program at once, whichever threads they are in: zero effort within a tick of each.

    Call it from any thread, task or signal handler; it waits for nothing. Each stopped call raises `StoppedError`, and
    its recording ends ``stopped``; a map begins nothing more. Other programs keep running, since
    this one may not own their rigs: the command ``rig stop`` stops all.

    Returns
    -------
    int
        How many trials were running.
    """
    return stop_requests.request()


@takes(WallSettings)
def plan(
    experiment: ExperimentLike = DEFAULT_PRESET,
    *,
    law: str | Law | None = None,
    estimator: str | Estimator | None = None,
    url: str | None = None,
    realtime: bool = False,
    round_trip_s: float | None = None,
    **settings: Unpack[WallSettings],
) -> Plan:
    """List what a hit would do, and check it; no device is touched, and what is refused is in the plan.

    Parameters as in `hit`. With `url`, `realtime` or `round_trip_s` (of the link, with the drive's behind a bridge, as
    `rig doctor` measures it) the wall is also judged with the delay of a link.

    Raises
    ------
    ConfigError, PlanError
        An invalid request; a round trip that is not above zero.
    """
    changes = changes_of(settings, WallSettings)
    own = _take_own_parts({"law": law, "estimator": estimator}, changes)
    with _register(*own):
        loaded = presets.load_named(experiment)
        linked = planning.is_linked(url, realtime=realtime, round_trip_s=round_trip_s)
        planned = config.with_realtime(loaded, changes) if linked else _change(loaded, changes)
        config.check_plugins(planned, planned.rig.name)
        run = controller.prepare_controller(planned, law=own[0])
        return planning.plan_of(run, linked=linked, round_trip_s=round_trip_s)


@takes(WallSettings)
def replay(
    recording: str | Path | Recording,
    *,
    law: str | Law | None = None,
    estimator: str | Estimator | None = None,
    **settings: Unpack[WallSettings],
) -> ReplayResult:
    """Run the inputs of a recording through its law and estimator again, or through others, and compare.

    Parameters
    ----------
    recording
        It, or its file.
    law, estimator
        Others than the recorded ones: by name, or of your own. One of your own that was recorded must be given too.
    **settings
        As in `load`.

    Raises
    ------
    RecordingError
        The recording lacks its beginning, or ticks in the middle.
    ConfigError
        The settings are invalid, or the law or estimator of the recording is not known here.
    LawError
        The law or the estimator raised an exception.
    """
    opened = recording if isinstance(recording, Recording) else open_recording(recording)
    changes = changes_of(settings, WallSettings)
    own_law, own_estimator = _take_own_parts({"law": law, "estimator": estimator}, changes)
    recorded = opened.header["initial_state"]
    if changes.get("controller.estimator") == recorded["estimator"]["name"] and len(changes) == 1:
        changes = {}  # the recorded one: with the parameters that it had
    if own_law is not None and own_law.name != recorded["law"]["name"]:
        changes["wall.law"] = own_law.name
    with _register(own_law, own_estimator):
        return replaying.replay(opened, changes, law=own_law)


@takes(WallSettings)
def compare(
    experiment: ExperimentLike = DEFAULT_PRESET,
    schemes: Sequence[str | Scheme] = (),
    *,
    offsets: Sequence[float] = OFFSETS,
    law: str | Law | None = None,
    estimator: str | Estimator | None = None,
    **settings: Unpack[WallSettings],
) -> SchemeComparison:
    """Simulate the same hit under several schemes (`rig compare`); nothing is recorded.

    Parameters
    ----------
    experiment
        As in `load`; the motor pushes, without a hand.
    schemes
        ``"dual:20k/2k,estimator=kalman"``, ``"uniform:20k"``, ``"none"`` for no damping; no damping, uniform and
        dual-rate at the experiment's rates if empty.
    offsets
        Where position zero lies in its encoder cell (count, 0 to below 1): one hit each, of whose numbers the result
        has the mean.
    law, estimator
        Name of a built-in or installed one, or one of your own.
    **settings
        As in `load`.

    Raises
    ------
    ConfigError
        A scheme or an offset that cannot be, a hand on the rig, or a handle that never reaches the wall.
    """
    changes = changes_of(settings, WallSettings)
    refuse_unused(changes)
    own = _take_own_parts({"law": law, "estimator": estimator}, changes)
    if own[0] is not None:
        changes["wall.law"] = own[0].name
    with _register(*own):
        loaded = _change(experiment, changes)
        return comparing.compare(loaded, entries_of(loaded, schemes), offsets=offsets)


@takes(Settings)
def zwidth(
    experiment: ExperimentLike = DEFAULT_PRESET,
    schemes: Sequence[str | Scheme] = (),
    *,
    dampings: Sequence[float] | None = None,
    lowest: float | None = None,
    highest: float | None = None,
    search: Way = "ladder",
    ratio: float = 1.06,
    offsets: Sequence[float] | None = None,
    repeats: int = 1,
    judged: Judged | None = None,
    law: str | Law | None = None,
    estimator: str | Estimator | None = None,
    directory: str | Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    watch: Callable[[sweep.Progress], None] | None = None,
    **settings: Unpack[Settings],
) -> ZWidth:
    """Map the walls that a simulated rig renders stably, by hitting them (`rig zwidth`).

    Parameters
    ----------
    experiment
        As in `load`. A preset is held by a simulated hand with a normal grip, unless settings say who pushes.
    schemes
        One curve each, as ``"dual:20k/2k,estimator=kalman"``; the experiment's and the uniform ones of its rates if
        empty.
    dampings, offsets, repeats, judged
        As in `rig.experiments.mapping._ranges.hit_plan`.
    lowest, highest, search, ratio
        Range of the stiffness, and the way through it: `rig.experiments.mapping._ranges.search_for`.
    law, estimator
        Name, or one of your own. Other processes can use yours only when a package installs it: see `directory`.
    directory
        Where the map is kept, and resumed when it was stopped; not kept if None.
    workers, scheduler, watch
        As in `rig.experiments.sweep.run`.

    Raises
    ------
    ConfigError, PlanError
        A scheme or a range that cannot be.
    StoppedError
        Ctrl-C; what is done stays in the directory.
    """
    changes = changes_of(settings, Settings)
    own = _take_own_parts({"law": law, "estimator": estimator}, changes)
    if own[0] is not None:
        changes["wall.law"] = own[0].name
    if (scheduler, directory) != (None, None):
        _refuse_what_is_not_installed(*own)
    with _register(*own):
        loaded = _put_in_hand(experiment, changes)
        parsed = [Scheme.parse(scheme) if isinstance(scheme, str) else scheme for scheme in schemes]
        chosen = schemes_for(loaded, parsed, dampings)
        planned = hit_plan(
            loaded,
            chosen,
            dampings=dampings,
            search=search_for(loaded, search, ratio=ratio, lowest=lowest, highest=highest, schemes=chosen),
            offsets=offsets,
            repeats=repeats,
            judged=judged,
        )
        if directory is None:
            return maps.zwidth(planned, scheduler=scheduler, workers=workers, watch=watch)
        place = maps.directory_for(planned, Path(directory), "zwidth")
        return maps.map_into(planned, place, scheduler=scheduler, workers=workers, watch=watch)


@takes(Settings)
def design(
    experiment: ExperimentLike = DEFAULT_PRESET,
    goal: designing.Goal = "area",
    *,
    must_be_stable: tuple[float, float] | None = None,
    fidelity_to: float | None = None,
    most_noise: float | None = None,
    most_cost: float | None = None,
    where: Literal["host", "device", "both"] | None = None,
    most_rate: int | None = None,
    link: float | None = None,
    round_trip_s: float | None = None,
    schemes: Sequence[str | Scheme] = (),
    paper: bool = False,
    directory: str | Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    watch: Callable[[str, sweep.Progress], None] | None = None,
    **settings: Unpack[Settings],
) -> designing.Design:
    """Find rates, estimator and filter for a rig by simulated hits (`rig design`); `toml()` of the result is to paste.

    Parameters
    ----------
    experiment
        As in `zwidth`. Limits of felt, heard and moved are its own: ``changes={"verdict.heard_force": 0.5}``.
    goal, must_be_stable, fidelity_to, most_noise, most_cost
        Goal, K and B of a wall that must be stable, and the other wishes: `rig.experiments.design.Wishes`.
    where
        The law may run: on this computer, on the device, or on both; where the experiment's own does if None.
    most_rate, link, round_trip_s
        Highest position rate of the board (Hz), the experiment's own if None; what the link carries (bytes/s), anything
        if None; how long a law on this computer takes to answer a sample (s), as the experiment says if None.
    schemes
        To choose from; the listed set of `rig.experiments.design._listing` if empty.
    paper
        True if the schemes of the rig's own paper are compared with all of that set, too.
    directory
        Where the search is kept, and resumed when it was stopped; not kept if None.
    workers, scheduler, watch
        As in `rig.experiments.sweep.run`; `watch` is also called with the name of the stage.

    Raises
    ------
    ConfigError, PlanError
        A scheme that cannot be; or no scheme fulfils the wishes: which one binds, and by how much.
    StoppedError
        Ctrl-C; what is done stays in the directory.
    """
    held = _put_in_hand(experiment, changes_of(settings, Settings))
    request = designing.DesignRequest(
        experiment=held,
        wishes=designing.Wishes(
            goal=goal, wall=must_be_stable, fidelity_hz=fidelity_to, noise=most_noise, cost=most_cost
        ),
        places=designing.places_for(
            held, where, rate_maximum=most_rate, bytes_per_second=link, round_trip_s=round_trip_s
        ),
        schemes=tuple(Scheme.parse(one) if isinstance(one, str) else one for one in schemes),
        paper=paper,
    )
    place = None if directory is None else designing.directory_for(request, Path(directory))
    return designing.design(request, place, scheduler=scheduler, workers=workers, watch=watch)


def _put_in_hand(experiment: ExperimentLike, changes: dict[str, Any]) -> Experiment:
    """Return an experiment with changes; a preset is in a simulated hand, unless they say who pushes."""
    built_in = isinstance(experiment, str) and experiment in presets.names()
    if built_in and not {"trial.kind", "trial.effort"} & set(changes):
        changes = changes | changes_of({"operator": "normal"}, Settings)
    return _change(experiment, changes)


def _print_message(text: str) -> None:
    print(f"rig: {text}", file=sys.stderr)


def _change(experiment: ExperimentLike, changes: Mapping[str, Any]) -> Experiment:
    loaded = presets.load_named(experiment)
    return config.override(loaded, changes, "the settings") if changes else loaded


def _take_own_parts(
    options: Mapping[str, Any], changes: dict[str, Any]
) -> tuple[Law | None, Estimator | None]:
    """Return a law and an estimator that are no names; names, and that of the estimator, are put into the changes."""
    law, estimator = options.get("law"), options.get("estimator")
    if isinstance(law, str):
        changes["wall.law"], law = law, None
    if estimator is not None:
        changes["controller.estimator"] = estimator if isinstance(estimator, str) else estimator.name
    for part, kind, decorator in ((law, Law, "law"), (estimator, Estimator | str, "estimator")):
        if part is not None and not isinstance(part, kind):
            raise ConfigError(
                f"{decorator} must be a name or a part made by @rig.{decorator}(…), and is a "
                f"{type(part).__name__}",
                remedy=f"give a name, or a function decorated by @rig.{decorator}(…)",
            )
    return law, None if isinstance(estimator, str) else estimator


@contextmanager
def _register(law: Law | None, estimator: Estimator | None) -> Iterator[None]:
    """Register a law and an estimator of the caller for a while, unless they are given by name."""
    with ExitStack() as stack:
        if law is not None:
            stack.enter_context(plugins.register_temporarily("rig.laws", laws.BUILT_IN, law.name, law))
        if estimator is not None and not _built_in(estimator):
            stack.enter_context(
                plugins.register_temporarily("rig.estimators", estimators.BUILT_IN, estimator.name, estimator)
            )
        yield


def _built_in(estimator: Estimator) -> bool:
    return estimator.name in estimators.BUILT_IN and estimators.get(estimator.name) is estimator


def _refuse_what_is_not_installed(law: Law | None, estimator: Estimator | None) -> None:
    """Another process, or a later one, finds a part by its name in an installed package or not at all."""
    for part, get, group in ((law, laws.get, "rig.laws"), (estimator, estimators.get, "rig.estimators")):
        try:
            known = part is None or get(part.name) is part
        except ConfigError:
            known = False
        if part is not None and not known:
            raise ConfigError(
                f"{part.name} is defined in this program only: other processes cannot run it, and a "
                "later program cannot resume it",
                remedy=f'install it in a package with the entry point {part.name} in the group "{group}", or leave '
                "out scheduler and directory",
            )
