"""How templates write numbers, counts and lists: filters of every template of this package."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

MINUS = "−"
NOTHING = "–"


def number(value: float | None, digits: int = 4) -> str:
    """A number with so many significant digits; a dash where there is none."""
    return NOTHING if value is None or not math.isfinite(value) else _minus(f"{value:.{digits}g}")


def signed(value: float, digits: int = 4) -> str:
    """A difference, with its sign."""
    return _minus(f"{value:+.{digits}g}") if math.isfinite(value) else NOTHING


def interval(low: float | None, high: float | None, decimals: int | None = None) -> str:
    """An interval, perhaps open above; a dash where there is none, or it is open on both sides."""
    if low is None or high is None or math.isnan(low) or math.isnan(high) or math.isinf(low):
        return NOTHING
    how = ".4g" if decimals is None else f".{decimals}f"
    if math.isinf(high):
        return f"{low:{how}} … ∞" if low > 0.0 else NOTHING
    return _minus(f"{low:{how}} … {high:{how}}")


def percent(share: float | None, decimals: int = 0) -> str:
    """A share in percent."""
    return NOTHING if share is None or not math.isfinite(share) else f"{100 * share:.{decimals}f} %"


def p(value: float) -> str:
    """A p value."""
    if not math.isfinite(value):
        return NOTHING
    return "< 0.001" if value < 0.001 else f"{value:.3f}"


def p_equals(value: float) -> str:
    """What follows the letter p in a sentence."""
    return p(value) if value < 0.001 else f"= {p(value)}"


def clock(seconds: float) -> str:
    """Hours, minutes and seconds."""
    whole = round(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"


def duration(seconds: float) -> str:
    """A stretch of time in the two units that suit it."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def counted(count: int, noun: str) -> str:
    """A count and its noun: ``1 trial``, ``3 trials``."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def shortest(value: float) -> str:
    """A number that somebody chose, in its shortest form."""
    return f"{value:g}"


def numbers(values: Iterable[float]) -> list[str]:
    """Numbers in their shortest form."""
    return [shortest(value) for value in values]


def listed(words: Iterable[Any], last: str = "and") -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    *first, end = [str(word) for word in words] or [""]
    return f"{', '.join(first)} {last} {end}" if first else end


def sentence(text: str) -> str:
    """A clause as a sentence: a capital, and one full stop."""
    return f"{text[:1].upper()}{text[1:].rstrip('.')}." if text else ""


def _minus(text: str) -> str:
    return text.replace("-", MINUS)


FILTERS: Mapping[str, Callable[..., Any]] = {
    "g": shortest,
    "number": number,
    "signed": signed,
    "percent": percent,
    "p": p,
    "p_equals": p_equals,
    "clock": clock,
    "duration": duration,
    "counted": counted,
    "listed": listed,
    "numbers": numbers,
    "sentence": sentence,
}
FUNCTIONS: Mapping[str, Callable[..., str]] = {"interval": interval}
