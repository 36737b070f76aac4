"""Compute the order of a session: its blocks (groups of searches), the searches in each, and the rule of each search.

A search is a sequence of trials that finds the stiffest stable wall of one condition at one damping. Each participant
has a row in the table of orders, from 0. A Latin square uses Williams' designs: over a cycle of rows each condition is
equally often at each position, and equally often after each other condition (Williams, Australian Journal of Scientific
Research A 2, 1949). The engine and the analysis use it. A log stores only protocol and row: with another order, older
logs would be misread.
"""

import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, TypeVar

from rig.session import search
from rig.session.planning._protocol import Protocol, Search
from rig.session.search import Estimate, JudgedProbe, Probe

PRACTICE = 0  # number of the block, and of the run, of the practice trials
# JSON parsers of any language read whole numbers below 2^53 without loss.
LARGEST_SEED = 2**53
# A quotient of decimals, such as 0.3 / 0.1, may lie this far below a whole number of steps.
ROUNDING = 1e-9

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchRun:
    """One search for the stiffest stable wall in a session, or the practice trials.

    It has a number (from 1; 0 is practice), a condition, a damping, and the number of its repeat. `seed` decides its
    random choices; it differs between searches and participants.
    """

    number: int
    condition: str
    damping: float
    repeat: int = 1  # from 1
    practice: bool = False
    seed: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """Group of searches for the stiffest stable wall, between two breaks of a session; block 0 is practice.

    If `interleave` is True, the trials of the block's searches alternate.
    """

    number: int
    runs: tuple[SearchRun, ...]
    practice: bool = False
    interleave: bool = False


def schedule(protocol: Protocol, row: int) -> tuple[Block, ...]:
    """Return the blocks (groups of searches) of a participant's session in their order, practice first.

    `row` is the participant's row in the table of orders: the first participant has 0, the next one 1.
    """
    if row < 0:
        raise ValueError(f"row = {row} in the table of condition orders must not be below 0")
    groups = _searches_by_block(protocol, row)
    blocks = list(_practice(protocol, row))
    number = 0
    for place, cells in enumerate(groups, start=1):
        runs = []
        for (condition, damping), repeat in cells:
            number += 1
            runs.append(
                SearchRun(
                    number=number,
                    condition=condition,
                    damping=damping,
                    repeat=repeat,
                    seed=_seed(protocol.study.seed, row, number),
                )
            )
        blocks.append(Block(number=place, runs=tuple(runs), interleave=protocol.order.interleave))
    return tuple(blocks)


def rows_of(protocol: Protocol) -> int:
    """Return after how many participants the order of conditions repeats; 1 unless the order is a Latin square."""
    if protocol.order.kind != "latin-square":
        return 1
    if protocol.order.blocks == "condition":
        conditions_by_fit = _group_by_fit(protocol)
        within = math.lcm(*(_count_rows(len(names)) for names in conditions_by_fit.values()))
        dampings = [len(condition.damping) for condition in protocol.condition]
        return math.lcm(_count_rows(len(conditions_by_fit)) * within, *map(_count_rows, dampings))
    return _count_rows(len(cells_of(protocol)))


def cells_of(protocol: Protocol) -> tuple[tuple[str, float], ...]:
    """Return each pair of condition and damping for which a protocol searches the stiffest stable wall."""
    return tuple((one.name, damping) for one in protocol.condition for damping in one.damping)


def rule_of(protocol: Protocol, run: SearchRun) -> search.Rule:
    """Return the rule by which a search chooses walls, without catch trials; practice presents each wall once."""
    if run.practice:
        return InOrder(protocol.practice.stiffness)
    return rule(protocol.search_of(protocol.condition_named(run.condition)), run.seed)


def asking_of(protocol: Protocol, run: SearchRun) -> search.Rule:
    """Return the rule by which a search chooses walls, with catch trials (known verdict) if the protocol has any."""
    if run.practice:
        return rule_of(protocol, run)
    return asking(protocol.search_of(protocol.condition_named(run.condition)), run.seed)


def asking(wanted: Search, seed: int) -> search.Rule:
    """Return the rule by which a search chooses walls, with catch trials (known verdict) if `wanted` has any."""
    own = rule(wanted, seed)
    if not wanted.catch_share:
        return own
    return search.Catching(rule=own, levels=levels_of(wanted), share=wanted.catch_share, seed=seed)


def rule(wanted: Search, seed: int) -> search.Rule:
    """Return the rule by which a search chooses walls, without catch trials; raise `ConfigError` for bad settings."""
    levels = levels_of(wanted)
    settings: Mapping[str, Any] = wanted.settings
    start = settings.get("start")
    if isinstance(start, int | float) and not isinstance(start, bool) and levels[0] <= start <= levels[-1]:
        settings = {**settings, "start": min(levels, key=lambda level: abs(level - start))}
    return search.make(wanted.rule, levels=levels, seed=seed, **settings)


def levels_of(wanted: Search) -> tuple[float, ...]:
    """Return the stiffnesses that a search may present, ascending, from `lowest` to at most `highest`."""
    steps = level_steps(wanted)
    if wanted.step is not None:
        values = (wanted.lowest + wanted.step * place for place in range(steps + 1))
    else:
        values = (wanted.lowest * (wanted.ratio or 1.0) ** place for place in range(steps + 1))
    # Without rounding, 0.1 · 3 would be 0.30000000000000004 in tables and logs.
    return tuple(float(f"{value:.12g}") for value in values)


def level_steps(wanted: Search) -> int:
    """Return the number of steps from the lowest to the highest stiffness that a search may present."""
    if wanted.step is not None:
        steps = (wanted.highest - wanted.lowest) / wanted.step
    else:
        steps = math.log(wanted.highest / wanted.lowest) / math.log(wanted.ratio or math.inf)
    return math.floor(steps + ROUNDING)


@dataclass(frozen=True)
class InOrder:
    """Rule for practice trials: present each wall once, whatever the verdicts; estimate nothing."""

    levels: Sequence[float]

    def next(self, answers: Sequence[JudgedProbe]) -> Probe | None:
        """Return the next practice wall; None after the last one."""
        return Probe(self.levels[len(answers)]) if len(answers) < len(self.levels) else None

    def estimate(self, answers: Sequence[JudgedProbe]) -> Estimate:
        """Return an estimate without a value (NaN), because practice does not search for the stiffest stable wall."""
        return Estimate(
            value=math.nan, low=0.0, high=math.inf, share=math.nan, censored="", hits=len(answers)
        )


def williams(items: Sequence[T], row: int) -> tuple[T, ...]:
    """Return items in the order of a row of a Williams design, a balanced Latin square of n rows (2 n if n is odd)."""
    n = len(items)
    row %= _count_rows(n)
    # Rows of the square and of its mirror image alternate, so that half a cycle is nearly balanced as well.
    mirrored = n % 2 == 1 and row % 2 == 1
    shift = row // 2 if n % 2 else row
    zigzag = [(place + 1) // 2 if place % 2 else -(place // 2) for place in range(n)]  # 0, 1, -1, 2, -2 …
    order = tuple(items[(place + shift) % n] for place in zigzag)
    return order[::-1] if mirrored else order


def _count_rows(n: int) -> int:
    # An odd number of conditions needs a square and its mirror image.
    return 2 * n if n % 2 and n > 1 else n


_Cell = tuple[tuple[str, float], int]  # (condition, damping) of a search, and number of its repeat from 1


def _searches_by_block(protocol: Protocol, row: int) -> list[list[_Cell]]:
    """Return (condition, damping) and repeat number of the searches in each block, in the order of the session."""
    order, cells = protocol.order, cells_of(protocol)
    repeats = range(1, order.repeats + 1)
    if order.blocks == "condition":
        conditions_by_fit = _group_by_fit(protocol)
        # Each order of conditions is combined with each order of the fitted parts.
        square = order.kind == "latin-square"
        within = row // _count_rows(len(conditions_by_fit)) if square else row
        names = [
            name
            for fit in _arrange(protocol, "fits", list(conditions_by_fit), row)
            for name in _arrange(protocol, f"conditions{fit}", conditions_by_fit[fit], within)
        ]
        return [
            [
                (cell, repeat)
                for repeat in repeats
                for cell in _arrange(
                    protocol,
                    f"{name}/{repeat}",
                    [cell for cell in cells if cell[0] == name],
                    row + repeat - 1,
                )
            ]
            for name in names
        ]
    if order.blocks == "one" and order.kind == "randomised":
        every = [(cell, repeat) for repeat, cell in product(repeats, cells)]
        drawn = _draw(every, f"{protocol.study.seed}/{row}/all")
        return [_count_repeats(cell for cell, _ in drawn)]
    by_repeat = [
        [(cell, repeat) for cell in _arrange(protocol, f"{repeat}", cells, row + repeat - 1)]
        for repeat in repeats
    ]
    return by_repeat if order.blocks == "repeat" else [[cell for block in by_repeat for cell in block]]


def _group_by_fit(protocol: Protocol) -> dict[str, list[str]]:
    """Return the names of conditions, grouped by the mechanical part that they need on the rig."""
    found: dict[str, list[str]] = {}
    for one in protocol.condition:
        found.setdefault(one.fit, []).append(one.name)
    return found


def _arrange(protocol: Protocol, what: str, items: Sequence[T], row: int) -> Sequence[T]:
    """Return items in the order that the protocol prescribes for a row: unchanged, random, or by a Latin square.

    `what` names the items and enters the seed, so that random orders are independent of each other.
    """
    seed = protocol.study.seed
    match protocol.order.kind:
        case "fixed":
            return items
        case "randomised":
            return _draw(items, f"{seed}/{row}/{what}")
    # Which item is which letter of the square is drawn once for the study.
    return williams(_draw(items, f"{seed}/letters/{len(items)}"), row)


def _count_repeats(cells: Iterable[tuple[str, float]]) -> list[_Cell]:
    seen: dict[tuple[str, float], int] = {}
    counted = []
    for cell in cells:
        seen[cell] = seen.get(cell, 0) + 1
        counted.append((cell, seen[cell]))
    return counted


def _practice(protocol: Protocol, row: int) -> list[Block]:
    practice = protocol.practice
    if not practice.stiffness:
        return []
    condition = protocol.condition_named(practice.condition or protocol.condition[0].name)
    run = SearchRun(
        number=PRACTICE,
        condition=condition.name,
        damping=condition.damping[0],
        practice=True,
        seed=_seed(protocol.study.seed, row, PRACTICE),
    )
    return [Block(number=PRACTICE, runs=(run,), practice=True)]


def _draw(items: Sequence[T], key: str) -> list[T]:
    # Drawn by hashing, not by a generator: the same order in every version of every library.
    places = sorted(range(len(items)), key=lambda place: _hash(f"{key}/{place}"))
    return [items[place] for place in places]


def _seed(*parts: int) -> int:
    return int.from_bytes(_hash("/".join(map(str, parts)))[:8], "big") % LARGEST_SEED


def _hash(text: str) -> bytes:
    return hashlib.sha256(text.encode()).digest()
