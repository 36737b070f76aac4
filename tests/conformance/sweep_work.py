"""Tasks for tests of sweeps, one of each kind that a sweep must survive; imported where the tasks run."""

import json
import math
import os
import re
import signal
import threading
import time
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from rig.core.errors import PlanError
from rig.experiments.sweep import Task
from rig.experiments.sweep._executors import as_json

Payload = dict[str, Any]


def sines(payload: Payload) -> list[dict[str, Any]]:
    """Return floats of all magnitudes from a seed, after a wait unrelated to the order of the tasks."""
    seed = payload["seed"]
    time.sleep(payload.get("wait_s", 0.0) * (seed * 7 % 5) / 4)
    values = np.random.default_rng(seed).normal(size=5) * 10.0 ** np.arange(-300, 301, 150)
    return [{"value": value, "trials": 2} for value in values]


def odd_values(payload: Payload) -> dict[str, Any]:
    """Return values that plain JSON cannot hold, or holds as another type."""
    return {
        "not a number": math.nan,
        "infinite": [math.inf, -math.inf],
        "zero": -0.0,
        "smallest": 5e-324,
        "tuple": (1, 2),
        "numpy": np.float32(0.1),
        "whole": np.int64(2**53 + 1),
        "array": np.linspace(0.0, 1.0, 4).reshape(2, 2),
        "text": "µ\u2028\ud800",
        "given": payload,
    }


def leave_a_mark(payload: Payload) -> str:
    with open(payload["log"], "a") as file:
        file.write(f"{payload['name']}\n")
    time.sleep(payload.get("wait_s", 0.0))
    return str(payload["name"])


def raise_as_given(payload: Payload) -> int:
    """Raise an error for some tasks, of the requested kind."""
    time.sleep(payload.get("wait_s", 0.0))
    match payload.get("raises"):
        case "ours":
            raise PlanError("this wall is out of reach", remedy="lower the stiffness")
        case "theirs":
            raise ZeroDivisionError
        case "exit":
            raise SystemExit("enough")
        case "not JSON":
            return object()  # type: ignore[return-value]
    return int(payload["number"])


def always_kill_the_worker(payload: Payload) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


GATES: defaultdict[str, threading.Event] = defaultdict(threading.Event)


def open_one_and_wait_for_another(payload: Payload) -> str:
    """Open a gate and wait at another, for tasks that must run at the same time in one process."""
    GATES[payload["opens"]].set()
    if not GATES[payload["waits_for"]].wait(20.0):
        raise TimeoutError(f"{payload['waits_for']} was not opened")
    return str(payload["opens"])


def wait_for_ever(payload: Payload) -> None:
    threading.Event().wait()


def large(payload: Payload) -> str:
    return "x" * int(payload["letters"])


# Tasks, and what came of them ------------------------------------------------------------------------


def sines_of(number: int, **payload: Any) -> list[Task]:
    return [Task(f"seed {seed}", sines, {"seed": seed, **payload}) for seed in range(number)]


def text(results: Iterable[Any]) -> list[str]:
    """Return results with all bits and types, NaN included."""
    return [as_json(result) for result in results]


def lines_of(data: bytes) -> list[bytes]:
    """Return lines with their newline, which the last may lack; `bytes.splitlines` splits at other characters too."""
    return re.findall(rb"[^\n]*\n|[^\n]+$", data)


def keys_in(journal: Path) -> list[str]:
    """Return the keys of the complete lines of a journal, in its order."""
    whole = [line for line in lines_of(journal.read_bytes()) if line.endswith(b"\n")]
    return [json.loads(line.partition(b" ")[2])["key"] for line in whole[1:]]
