"""Filters for all templates of reports, which format numbers, counts and lists as text.

A template uses them by their names, such as ``{{ ratio | times }}``.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

MINUS = "−"
NOTHING = "–"
_WORDS = (
    "no",
    "one",
    "two",
    "three",
    "four",
    "five",
    "six",
    "seven",
    "eight",
    "nine",
    "ten",
    "eleven",
    "twelve",
)


def number(value: float | None, digits: int = 4) -> str:
    """Return a number with up to `digits` significant digits, without trailing zeros, for use in a sentence.

    Return – if the number is missing or not finite.
    """
    return NOTHING if value is None or not math.isfinite(value) else _minus(f"{value:.{digits}g}")


def three(value: float | None, digits: int = 3) -> str:
    """Return a number with `digits` significant digits, with trailing zeros from 1 to 10⁶ (``2.50``), for tables.

    Return ∞ for infinity and – for a missing number.
    """
    if value is None or not math.isfinite(value):
        return "∞" if value == math.inf else NOTHING
    if value != 0.0 and 1.0 <= abs(value) < 10.0**6:
        return f"{value:.{max(0, digits - 1 - math.floor(math.log10(abs(value))))}f}"
    return f"{value:.{digits}g}"


def limit(value: float, capped: object) -> str:
    """Return a limit with three digits, with ``≥`` in front if `capped` (the search ended before the limit)."""
    return f"{'≥ ' if capped else ''}{three(value)}"


def times(ratio: float | None) -> str:
    """Return a ratio as a factor: ``× 1.25``."""
    return f"× {three(ratio)}"


def step(ratio: float) -> str:
    """Return in percent how much larger the next of two neighbouring values is: ratio 1.015 → ``1.5 %``."""
    return f"{100 * (ratio - 1):.2g} %"


def change(ratio: float) -> str:
    """Return a ratio of new to old value as a change in percent: 0.88 → ``−12 %``."""
    return _minus(f"{100 * (ratio - 1):+.0f} %") if math.isfinite(ratio) else "from nothing"


def khz(rate_hz: float) -> str:
    """Return a rate (Hz) in kilohertz: 20000 → ``20 kHz``."""
    return f"{rate_hz / 1e3:g} kHz"


def cell(value: Any) -> Any:
    """Return the content of a table's cell: a float with three digits, – for None, other values unchanged."""
    return three(value) if isinstance(value, float) or value is None else value


def prefixed(names: Iterable[str], text: str) -> list[str]:
    """Return the names, each with `text` in front."""
    return [text + name for name in names]


def suffixed(names: Iterable[str], text: str) -> list[str]:
    """Return the names, each with `text` behind."""
    return [name + text for name in names]


def each(items: Iterable[Any], between: str = "; ", *, caller: Callable[..., str]) -> str:
    """Return the joined texts of a jinja2 call block for each item: ``{% call(x, y) each(pairs) %}…{% endcall %}``."""
    written = [caller(*item) if isinstance(item, tuple) else caller(item) for item in items]
    return type(written[0])(between).join(text.strip() for text in written) if written else ""


def gathered(items: Mapping[str, tuple[Any, ...]], *, caller: Callable[..., str]) -> str:
    """Return the joined texts of a jinja2 call block for named items; names with equal text are listed together.

    An example of a result is ``a, b: text; c: other text``.
    """
    names: dict[str, list[str]] = {}
    for name, item in items.items():
        names.setdefault(caller(*item).strip(), []).append(name)
    return "; ".join(f"{', '.join(of)}: {text}" for text, of in names.items())


def signed(value: float, digits: int = 4) -> str:
    """Return a difference with its sign, also if it is positive: ``+0.25``; – if it is not finite."""
    return _minus(f"{value:+.{digits}g}") if math.isfinite(value) else NOTHING


def interval(low: float | None, high: float | None, decimals: int | None = None) -> str:
    """Return an interval: ``1.2 … 3.4``, or ``1.2 … ∞`` if the upper end is infinite; – if an end is missing."""
    if low is None or high is None or math.isnan(low) or math.isnan(high) or math.isinf(low):
        return NOTHING
    how = ".4g" if decimals is None else f".{decimals}f"
    if math.isinf(high):
        return f"{low:{how}} … ∞" if low > 0.0 else NOTHING
    return _minus(f"{low:{how}} … {high:{how}}")


def percent(share: float | None, decimals: int = 0) -> str:
    """Return a share in percent: 0.25 → ``25 %``; – if it is missing or not finite."""
    return NOTHING if share is None or not math.isfinite(share) else f"{100 * share:.{decimals}f} %"


def p(value: float) -> str:
    """Return a p value of a statistical test with three decimals: ``0.012``, or ``< 0.001``; – if it is not finite."""
    if not math.isfinite(value):
        return NOTHING
    return "< 0.001" if value < 0.001 else f"{value:.3f}"


def p_equals(value: float) -> str:
    """Return the text that follows the letter p in a sentence: ``= 0.012`` or ``< 0.001``."""
    return p(value) if value < 0.001 else f"= {p(value)}"


def clock(seconds: float) -> str:
    """Return a time (s) as hours, minutes and seconds: 3723 → ``1:02:03``."""
    whole = round(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"


def duration(seconds: float) -> str:
    """Return a time (s) in its two largest units: ``45 s``, ``3 min 20 s`` or ``1 h 5 min``."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def counted(count: int, noun: str) -> str:
    """Return a count with its noun, in the plural unless the count is 1: ``1 trial``, ``3 trials``."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def shortest(value: float, digits: int = 6) -> str:
    """Return a number with up to `digits` significant digits, without trailing zeros and with ``-`` as minus sign."""
    return f"{value:.{digits}g}"


def numbers(values: Iterable[float]) -> list[str]:
    """Return each number as text with up to six significant digits."""
    return [shortest(value) for value in values]


def counted_in_words(count: int, noun: str) -> str:
    """Return a count with its noun; counts up to twelve as a word: ``three trials``, ``13 trials``."""
    return (
        counted(count, noun).replace(str(count), _WORDS[count], 1)
        if count < len(_WORDS)
        else counted(count, noun)
    )


def sentence_start(text: str) -> str:
    """Return a text with a capital first letter."""
    return f"{text[:1].upper()}{text[1:]}"


def listed(words: Iterable[Any], last: str = "and") -> str:
    """Return words as a list in a sentence: ``a``, ``a and b`` or ``a, b and c``."""
    *first, end = [str(word) for word in words] or [""]
    return f"{', '.join(first)} {last} {end}" if first else end


def sentence(text: str) -> str:
    """Return a clause as a sentence: with a capital first letter and one full stop."""
    return f"{text[:1].upper()}{text[1:].rstrip('.')}." if text else ""


def _minus(text: str) -> str:
    return text.replace("-", MINUS)


TESTS: Mapping[str, Callable[..., bool]] = {"finite": math.isfinite}
FILTERS: Mapping[str, Callable[..., Any]] = {
    "g": shortest,
    "number": number,
    "n": three,
    "limit": limit,
    "times": times,
    "step": step,
    "change": change,
    "khz": khz,
    "cell": cell,
    "prefixed": prefixed,
    "suffixed": suffixed,
    "signed": signed,
    "percent": percent,
    "p": p,
    "p_equals": p_equals,
    "clock": clock,
    "duration": duration,
    "counted": counted,
    "counted_in_words": counted_in_words,
    "sentence_start": sentence_start,
    "listed": listed,
    "numbers": numbers,
    "sentence": sentence,
}
FUNCTIONS: Mapping[str, Callable[..., str]] = {"interval": interval, "each": each, "gathered": gathered}
