"""Times and counts from other loggers: CSV dialects, lost samples, irregular times rejected with their numbers."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rig
import rig.cli
from rig.core.errors import ConfigError, RecordingError
from rig.experiments.estimation.cases import recording_case
from rig.experiments.estimation.estimators import Variant, estimates, score
from rig.experiments.estimation.tuning import tune_estimator
from rig.recording.counts import WORST_DEVIATION, read_counts
from rig.recording.origin import counts_facts
from tests.conformance.tiers import first_by_default

RATE, DELTA, N = 1000, 1e-4, 2000
TIME_S = np.arange(N) / RATE
TRUE = np.round(900 * np.sin(2 * np.pi * 2 * TIME_S) + 2500 * TIME_S).astype(int)
LOST = np.flatnonzero(np.random.default_rng(3).random(N) < 0.02)
LOST = LOST[(LOST > 0) & (LOST < N - 1)]
KEPT = np.delete(np.arange(N), LOST)


def log(path: Path, times: Any, counts: Any, *, head: str = "t,c", line: str = "{},{}") -> Path:
    lines = [line.format(t, c) for t, c in zip(times, counts, strict=True)]
    path.write_text("\n".join(filter(None, [head, *lines])) + "\n", encoding="utf-8")
    return path


COMMAS = [f"{one:.4f}".replace(".", ",") for one in TIME_S]
DATES = np.datetime_as_string(
    np.datetime64("2026-01-01T08:00") + np.round(1e9 * TIME_S).astype("m8[ns]"), "us"
)
DIALECTS: dict[str, tuple[Any, dict[str, Any], dict[str, Any]]] = {
    "seconds": (TIME_S, {}, {}),
    "no header": (TIME_S, {"head": ""}, {"time": 0, "count": 1}),
    "other order, more columns": (TIME_S, {"head": "c,note,t", "line": "{1},ok,{0}"}, {}),
    "ms, whole": (np.arange(N) + 10**7, {}, {"time_unit": "ms"}),
    "µs": (1e6 * TIME_S, {}, {"time_unit": "us"}),
    "ns of the epoch": (1_766_000_000_000_000_000 + 10**6 * np.arange(N), {}, {"time_unit": "ns"}),
    "semicolons, decimal commas": (COMMAS, {"head": "t;c", "line": "{};{}"}, {}),
    "tabs, comments, a byte order mark": (
        TIME_S,
        {"head": "\ufeff# logger 7\n% 1 kHz\nt\tc", "line": "{}\t{}"},
        {},
    ),
    "blanks": (TIME_S, {"head": "t c", "line": "{} {}"}, {"delimiter": " "}),
    "dates": (DATES, {}, {}),
    "dates with a zone": ([f"{one}+01:00" for one in DATES], {}, {}),
}


@pytest.mark.parametrize("name", DIALECTS)
def test_any_dialect_gives_the_same_recording(name: str, tmp_path: Path) -> None:
    times, form, given = DIALECTS[name]
    path = log(tmp_path / "log.csv", [times[k] for k in KEPT], TRUE[KEPT], **form)
    found = read_counts(path, **{"time": "t", "count": "c", "resolution": DELTA, **given})
    assert found.column("count").tolist() == TRUE[KEPT].tolist()
    assert found.column("sample_index").tolist() == KEPT.tolist()
    assert found.column("elapsed_ticks").tolist() == np.diff(KEPT, prepend=-1).tolist()
    assert found.time_s == pytest.approx(TIME_S[KEPT], abs=2e-9)
    facts = counts_facts(found)
    assert facts is not None
    assert (facts["rate_hz"], facts["lost_samples"]) == (RATE, len(LOST))


@pytest.mark.parametrize("cell", ["", "NaN", "NA"])
@pytest.mark.parametrize("timed", [True, False])
def test_empty_cells_are_lost_samples(cell: str, timed: bool, tmp_path: Path) -> None:
    cells = [cell if k in LOST else str(c) for k, c in enumerate(TRUE)]
    path = log(tmp_path / "log.csv", TIME_S, cells)
    given: dict[str, Any] = {"time": "t"} if timed else {"period_s": 1 / RATE}
    found = read_counts(path, count="c", resolution=DELTA, **given)
    assert found.column("sample_index").tolist() == KEPT.tolist()


@pytest.mark.parametrize("width", first_by_default([12, 16]))
def test_estimators_run_over_imported_counts_as_over_arrays(width: int, tmp_path: Path) -> None:
    path = log(tmp_path / "log.csv", TIME_S[KEPT], (TRUE % 2**width)[KEPT])
    made = read_counts(path, time="t", count="c", width=width, resolution=DELTA)
    saved = rig.open_recording(rig.export(made, tmp_path / "log.parquet"))
    case = recording_case(saved)
    elapsed = np.diff(KEPT, prepend=-1)
    for name in ("fdm", "kalman", "period"):
        expected = rig.estimate(name, TRUE[KEPT], 1 / RATE, resolution=DELTA, elapsed=elapsed)
        assert estimates(case, Variant(name)) == pytest.approx(expected, rel=1e-6, abs=1e-6 * DELTA * RATE)
    true = DELTA * (900 * 4 * np.pi * np.cos(4 * np.pi * TIME_S) + 2500)
    speed = estimates(case, Variant("fdm"))
    assert np.sqrt(np.mean((speed[1:] - true[KEPT][1:]) ** 2)) < DELTA * RATE
    assert score(case, Variant("fdm")).delay_s == pytest.approx(0.5 / RATE, abs=1e-4)
    assert (
        tune_estimator("fdm-butterworth", case).objective_best <= score(case, Variant("fdm-butterworth")).rms
    )
    assert recording_case(saved, RATE / 2).elapsed.sum() == N // 2


def test_a_period_that_is_no_whole_rate_is_exact(tmp_path: Path) -> None:
    path = log(tmp_path / "log.csv", 3e-3 * np.arange(400), 7 * np.arange(400))
    case = recording_case(read_counts(path, time="t", count="c", resolution=DELTA))
    assert case.dt == pytest.approx(3e-3, rel=1e-9)
    assert estimates(case, Variant("fdm"))[1:] == pytest.approx(7 * DELTA / 3e-3)


@pytest.mark.parametrize("share", [0.5, 1.5])
def test_intervals_are_accepted_up_to_the_stated_share_of_a_period(share: float, tmp_path: Path) -> None:
    moved = TIME_S.copy()
    moved[500] += share * WORST_DEVIATION / RATE
    path = log(tmp_path / "log.csv", moved[KEPT], TRUE[KEPT])
    if share < 1.0:
        facts = counts_facts(read_counts(path, time="t", count="c", resolution=DELTA))
        assert facts is not None
        assert facts["deviation_max"] == pytest.approx(share * WORST_DEVIATION, rel=1e-3)
        assert 0.0 < facts["deviation_rms"] < facts["deviation_max"]
    else:
        with pytest.raises(
            RecordingError, match=r"irregular: [12] of \d+ intervals .* 0.001 s within 10%"
        ) as caught:
            read_counts(path, time="t", count="c", resolution=DELTA)
        assert "period_s" in caught.value.remedy


BROKEN: dict[str, tuple[str, str]] = {
    "time goes back": (
        "t,c\n0,1\n1,2\n2,3\n0,4\n1,5\n",
        r"does not increase in 1 rows, first in data row 3: 0 s after 2",
    ),
    "time stands still": ("t,c\n0,1\n1,2\n1,3\n2,4\n", r"does not increase in 1 rows, first in data row 2"),
    "two of a name": ("t,c,c\n0,1,1\n1,2,2\n2,3,3\n", "several columns with the name 'c'"),
    "nothing": ("\n# only this\n", "has no rows"),
    "no such column": ("time,c\n0,1\n1,2\n2,3\n", "no column 't'; its columns are time, c"),
    "no names": ("0,1\n1,2\n2,3\n", "no header line with column names"),
    "text": ("t,c\n0,one\n1,two\n2,three\n", "'c' does not hold numbers.*'one'"),
    "fractions": ("t,c\n0,0.5\n1,1.5\n2,2.5\n", r"counts\[0\] = 0.5 is not a whole number"),
    "a wrap without a width": ("t,c\n0,0\n1,250\n2,4\n3,14\n", "more than half of the range"),
    "a torn row": ("t,c\n0,1\n1,2\n2\n", "whose rows have equal numbers of columns"),
    "too few": ("t,c\n0,1\n1,2\n", "has 2 rows with a count and a time"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_unreadable_log_is_refused_with_a_remedy(name: str, tmp_path: Path) -> None:
    text, message = BROKEN[name]
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(RecordingError, match=message) as caught:
        read_counts(path, time="t", count="c", resolution=DELTA)
    assert str(path) in caught.value.message
    assert caught.value.remedy


def test_invalid_arguments_are_refused(tmp_path: Path) -> None:
    timed = {"time": "t"}
    for given in ({}, {"period_s": 0.0}, timed | {"period_s": 1.0}, timed | {"time_unit": "min"}):
        with pytest.raises(ConfigError):
            read_counts(tmp_path / "log.csv", **{"count": "c", "resolution": DELTA, **given})
    with pytest.raises(ConfigError):
        read_counts(tmp_path / "log.csv", time="t", count="c", resolution=0.0)


def test_commands_take_imported_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    def run(*arguments: str) -> tuple[int, str, str]:
        code = rig.cli.run([*arguments])
        return code, *capsys.readouterr()

    monkeypatch.chdir(tmp_path)
    log(tmp_path / "log.csv", TIME_S[KEPT], (TRUE % 4096)[KEPT])
    importing = [
        "recording", "import", "log.csv", "--time-column", "t", "--count", "1", "--resolution", "1e-4",
    ]  # fmt: skip
    code, _, err = run(*importing)
    assert code != 0
    assert "width=16" in err
    code, out, _ = run(*importing, "--width", "12", "--json")
    facts = json.loads(out)
    assert (code, facts["lost_samples"], facts["rate_hz"], facts["rows"]) == (0, len(LOST), RATE, len(KEPT))
    code, out, _ = run("show", "log.parquet", "--plot")
    assert code == 0
    assert f"{len(LOST)} samples in" in out
    assert "12 bits" in out
    assert (tmp_path / "log.png").stat().st_size > 10_000
    assert json.loads(run("show", "log.parquet", "--json")[1])["header"]["extra"]["counts"]["width"] == 12
    comparing = [
        "estimators", "compare", "log.parquet", "--estimator", "fdm", "--no-time", "--no-plot", "--json",
    ]  # fmt: skip
    assert all(np.isfinite(one["rms"]) for one in json.loads(run(*comparing)[1])["scores"])
    for command in (
        ("recording", "replay", "log.parquet"),
        ("show", "log.parquet", "--xy"),
        ("show", "log.parquet", "--expect", "stable"),
    ):
        code, _, err = run(*command)
        assert code != 0
        assert "imported from log.csv: it has encoder counts" in err
