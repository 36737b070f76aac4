"""Define the functions of the Python interface, like `rig.hit`: arguments are an experiment and settings.

Each function adapts its arguments, calls the same function as the command of the same name, and returns one result.
"""

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
    """Keywords of `hit`: settings of the experiment, and options of the run (device, law, recording)."""

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
    """Load an experiment, change some of its keys, and return the checked experiment.

    Parameters
    ----------
    experiment
        A preset's name (``"koul-compliant"``), the path of a file (it ends in ``.toml`` or has a slash), or an
        experiment.
    **settings
        Values in SI units of the rig: ``stiffness=100.0``; any other key by ``changes={"wall.position": 0.1}``.
        `operator` names the grip of a simulated hand that pushes (relaxed, normal, firm); with "none" the motor pushes.

    Raises
    ------
    ConfigError
        The preset, file or setting does not exist, or a value is invalid; the message names key, range and remedy.
    """
    return _change(experiment, changes_of(settings, WallSettings))


@takes(HitOptions, HitRequest)
def hit(
    experiment: ExperimentLike = DEFAULT_PRESET, watch: Watch | None = None, **options: Unpack[HitOptions]
) -> HitResult:
    """Hit a wall once: home the handle, push it into the wall, record the hit, and judge if it was stable.

    Parameters
    ----------
    experiment
        Preset's name, path of a TOML file, or experiment.
    watch
        Called before the hit with the number 0 and the experiment as it runs. `watch` may return a progress function,
        which is called with (ticks, phase) while the hit runs.
    **options
        Settings in SI units, like ``stiffness=100.0``, and: `law`, `estimator` (a name, or your own); an open `device`
        instead of a `url`; `hands_off`, called before a torque pulse during which no hand may hold a real rig (by
        default it prints a line to standard error); the `name` of the recording.

    Raises
    ------
    ConfigError, PlanError
        The request is invalid or not permitted; nothing has moved.
    RigError
        The hit ended early; the effort is zero, and the error's attribute `recording` is the path of the recording.
    """
    given: dict[str, Any] = {"hands_off": _print_message, **options}
    changes, loaded = changes_of(options, HitOptions), presets.load_named(experiment)
    repeats = changes.get("trial.repeats", loaded.trial.repeats)
    if repeats != 1:
        raise ConfigError(
            f"trial.repeats = {repeats!r}: this function returns a single result, so it must be 1",
            remedy="give repeats=1, and call this function in a loop; for several hits on one "
            "device, pass the open device",
        )
    law, estimator = _take_own_parts(given, changes)
    own = {one.name: given[one.name] for one in fields(HitRequest) if one.name in given}
    request = HitRequest(**{**own, "experiment": loaded, "changes": changes, "law": law})
    with _register(law, estimator):
        (result,) = one_hit.hit(request, admit, watch)
    return result


def stop() -> int:
    """Stop all runs of this program, in all threads; each loop sends zero effort in its next tick.

    Call this function from any thread, task or signal handler; it returns at once. Each stopped call raises
    `StoppedError`, and the end reason in its recording is ``stopped``; a map of stable walls starts no more hits. Runs
    of other programs continue, because their rigs may belong to other people; the command ``rig stop`` also stops other
    programs' runs.

    Returns
    -------
    int
        Number of trials that were running.
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
    """Return the plan of a hit: its steps and checks, with the outcome of each check; no device is opened.

    The settings are those of the hit, in SI units. With `url`, `realtime` or `round_trip_s` the wall is also checked
    with the delay of a link. `round_trip_s` is the round trip of the link, and of a drive behind it, by `rig doctor`
    (s).

    Raises
    ------
    ConfigError, PlanError
        The request is invalid, or the round trip is not above 0.
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
    """Replay a recording: run its law and estimator, or others, on the recorded samples, and compare the commands.

    Parameters
    ----------
    recording
        A recording, or the path of its file.
    law, estimator
        Name, or your own law or estimator, to use instead of the recorded ones. If the recording was made with your own
        law or estimator, pass it here.
    **settings
        Values of keys to change, in SI units, like ``stiffness=100.0``.

    Raises
    ------
    RecordingError
        The recording lacks its beginning, or ticks in the middle.
    ConfigError
        The settings are invalid, or the law or estimator of the recording is not installed.
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
    """Simulate the same hit under several sampling schemes (`rig compare`) and compare them; nothing is recorded.

    Parameters
    ----------
    experiment
        Preset's name, path of a TOML file, or experiment; the motor pushes, without a hand.
    schemes
        For example ``"dual:20k/2k,estimator=kalman"``, ``"uniform:20k"``, ``"none"`` for no damping. If empty, three
        sampling schemes at the experiment's rates: no damping, uniform and dual-rate.
    offsets
        Distances of position zero from the lower edge of its encoder cell (counts, 0 to below 1). One hit is simulated
        for each offset, and the result has the mean of the hits' numbers.
    law, estimator
        Name of a built-in or installed law or estimator, or your own.
    **settings
        Values of keys to change, in SI units, like ``stiffness=100.0``.

    Raises
    ------
    ConfigError
        A scheme or an offset is invalid, the trial has a hand, or the handle never reaches the wall.
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
    """Find the stiffest stable walls of a simulated rig for each damping, by simulated hits (`rig zwidth`).

    Parameters
    ----------
    experiment
        Preset's name, path of a TOML file, or experiment. A simulated hand with a normal grip pushes a preset, unless
        the settings have `operator`, `effort` or ``trial.kind``.
    schemes
        Sampling schemes like ``"dual:20k/2k,estimator=kalman"``, one curve each. If empty: the experiment's scheme, and
        the uniform schemes at its rates.
    dampings, offsets, repeats, judged
        Dampings (N·m·s/rad or N·s/m), encoder offsets (counts), hits of each wall, and judged signals: ``"recorded"``,
        or the simulation's ``"true"`` ones.
    lowest, highest, search, ratio
        Range of the stiffness (N·m/rad or N/m), method of the search, and ratio of two tested stiffnesses.
    law, estimator
        Name, or your own. With `scheduler` or `directory` your own must be installed by a package, because other
        processes must find it.
    directory
        Directory in which the map is stored; a stopped map resumes from it. None: not stored.
    workers, scheduler, watch
        Number of threads, address of a Dask scheduler, and a function that is called with the progress.

    Raises
    ------
    ConfigError, PlanError
        A scheme or a range is invalid.
    StoppedError
        Ctrl-C was pressed; the results of finished parts stay in the directory.
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
    """Find rates, estimator and filter for a rig by simulated hits (`rig design`).

    `toml()` of the result returns the text to paste into an experiment file.

    Parameters
    ----------
    experiment
        Preset's name, path of a TOML file, or experiment. Its verdict has the limits of the ripples of velocity, effort
        and position; change a limit for example by ``changes={"verdict.heard_force": 0.5}``.
    goal, must_be_stable
        What to maximise (stiffness, damping or area of stable walls; quiet: least noise), and K and B that must be
        stable.
    fidelity_to, most_noise, most_cost
        Frequency up to which the velocity must be faithful (Hz), largest rms velocity at rest, most processor cycles
        per tick.
    where
        Where the law may run: on this computer, on the device, or both; None: where the experiment's law runs.
    most_rate, link, round_trip_s
        Highest position rate of the board (Hz; None: the experiment's rate), capacity of the link (bytes/s; None: not
        limited), and time from a sample to the command that a law on this computer sends for it (s; None: from the
        experiment).
    schemes
        Schemes to choose from; if empty, the set in `rig.experiments.design._listing`.
    paper
        True to add the sampling schemes of the paper that describes the rig.
    directory
        Directory in which the search is stored; a stopped search resumes from it. None: not stored.
    workers, scheduler, watch
        Number of threads, address of a Dask scheduler, and function that is called with the stage's name and progress.

    Raises
    ------
    ConfigError, PlanError
        A scheme is invalid, or no scheme meets the requirements; the message names the limiting one and by how much.
    StoppedError
        Ctrl-C was pressed; the results of finished parts stay in the directory.
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
    """Return the changed experiment; a simulated hand pushes a built-in rig unless `changes` set who pushes it."""
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
    """Return the caller's own law and estimator (None for a name), and write the names of both into `changes`.

    Raise `ConfigError` if an option is neither a name nor a function decorated by ``@rig.law`` or ``@rig.estimator``.
    """
    law, estimator = options.get("law"), options.get("estimator")
    if isinstance(law, str):
        changes["wall.law"], law = law, None
    if estimator is not None:
        changes["controller.estimator"] = estimator if isinstance(estimator, str) else estimator.name
    for part, kind, decorator in ((law, Law, "law"), (estimator, Estimator | str, "estimator")):
        if part is not None and not isinstance(part, kind):
            raise ConfigError(
                f"{decorator} is of type {type(part).__name__}; it must be a name, or a function decorated by "
                f"@rig.{decorator}(…)",
                remedy=f"give a name, or a function decorated by @rig.{decorator}(…)",
            )
    return law, None if isinstance(estimator, str) else estimator


@contextmanager
def _register(law: Law | None, estimator: Estimator | None) -> Iterator[None]:
    """Register the caller's own law and estimator by their names until the ``with`` block ends."""
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
    """Raise `ConfigError` for a law or estimator that no installed package provides: other processes cannot find it."""
    for part, get, group in ((law, laws.get, "rig.laws"), (estimator, estimators.get, "rig.estimators")):
        try:
            known = part is None or get(part.name) is part
        except ConfigError:
            known = False
        if part is not None and not known:
            raise ConfigError(
                f"{part.name} is defined in this program only: other processes cannot run it, and a "
                "later program cannot resume the map",
                remedy=f'install it in a package with the entry point {part.name} in the group "{group}", or leave '
                "out scheduler and directory",
            )
