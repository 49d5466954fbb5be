"""Functions of studies that worker processes can import."""

from __future__ import annotations

import os
import signal
import time
from typing import Any

import numpy as np

import stochens_rs as se
from stochens_rs import Key

TARGET = np.array([[1.0, -2.0], [0.5, 3.0]])
GRID = {"size": [3, 10, 30], "method": ["uniform", "alse"]}


def fused(key: Key, size: int, method: Any) -> dict[str, Any]:
    """Return the error of a fit, its estimate, and how many threads the core may use."""
    fit = se.fuse(se.sample(TARGET, size, rng=key), method, target=TARGET)
    return {"error": fit.error, "estimate": np.asarray(fit.estimate)}


def threads(key: Key) -> dict[str, int]:
    return {"threads": se.get_num_threads()}


def noise(key: Key, scale: float = 1.0) -> dict[str, float]:
    return {"x": scale * float(key.generator().normal())}


def slow(key: Key, scale: float = 1.0) -> dict[str, float]:
    time.sleep(0.004)
    return noise(key, scale)


class Clock:
    """Stands for the module `time`, so that `slow` takes 4 ms on every machine."""

    now = 0.0

    def monotonic(self) -> float:
        return self.now

    perf_counter = monotonic

    def sleep(self, seconds: float) -> None:
        self.now += seconds

    def __reduce__(self) -> str:  # its state says nothing of a function
        return "clock"


def prefixes(key: Key, size: Any) -> dict[str, Any]:
    """Return one error for each size, on prefixes of one sample."""
    ensemble = se.sample(TARGET, int(size[-1]), rng=key)
    return {"error": [se.fuse(ensemble.prefix(int(k)), target=TARGET).error for k in size]}


def sometimes(key: Key, scale: float) -> dict[str, float]:
    """Fail for about a fifth of the keys, unless the environment says not to."""
    found = noise(key, scale)
    if abs(found["x"]) > 1.3 * scale and "STUDY_TEST_CALM" not in os.environ:
        raise ValueError(f"x is {found['x']:.3f},\nwhich is large")
    return found


def deadly(key: Key, folder: str) -> dict[str, float]:
    """Kill the worker of every key once."""
    mark = os.path.join(folder, key.hex)
    if not os.path.exists(mark) and key.bytes32[0] < 100:
        open(mark, "w").close()
        os.kill(os.getpid(), signal.SIGKILL)
    return noise(key)


def deaf(key: se.Key, part: str) -> dict[str, float]:
    """One worker that SIGTERM does not end, and one that dies."""
    if part == "first":
        return {"x": 0.0}
    if part == "stays":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        time.sleep(600.0)
    time.sleep(0.5)
    os._exit(1)
