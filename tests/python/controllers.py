"""Controllers in C, compiled and called, and random loops of every kind to compare them with."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

import stochens_rs as se

FLAGS = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "-Wconversion"]
DRIVER = """#include "{name}.h"
#include <stddef.h>
{name} s;
size_t bytes(void) {{ return sizeof s; }}
void start(void) {{ {name}_start(&s); }}
int step(const {name}_real *y, {name}_real *u) {{ return {name}_step(&s, y, u); }}
{name}_real *applied(void) {{ return s.{applied}; }}
int target(const {name}_real *to) {{ return {target}; }}
int exchanges(void) {{ return {exchanges}; }}
double size(int j) {{ (void)j; return {size}; }}
"""


def compiler(name: str = "gcc") -> str | None:
    return shutil.which(name)


class Controller:
    """A compiled controller: `step` gives the code and the input."""

    def __init__(self, header: Path, m: int, single: bool = False, more: list[str] | None = None):
        name, text = header.stem, header.read_text("utf-8")
        plans = "_plan;" in text and "exchanges;" in text
        fields = {
            "applied": "applied" if "applied[" in text else "u",
            "target": f"{name}_target(&s, to)" if f"{name}_target(" in text else "!to",
            "exchanges": "s.plan.exchanges" if plans else "0",
            "size": "(double)s.plan.size[j]" if plans else "0.0",
        }
        source = header.with_name(f"{name}_driver.c")
        source.write_text(DRIVER.format(name=name, **fields))
        library = header.with_name(f"{name}{'f' if single else ''}.so")
        how = [f"-D{name.upper()}_FLOAT"] if single else []
        command = [compiler() or "gcc", *FLAGS, *how, *(more or []), "-fPIC", "-shared"]
        made = subprocess.run(
            [*command, str(source), "-o", str(library), "-lm"], capture_output=True, text=True
        )
        assert made.returncode == 0, made.stderr
        self.c, self.m = ctypes.CDLL(str(library)), m
        self.real: Any = np.float32 if single else np.float64
        kind = ctypes.POINTER(ctypes.c_float if single else ctypes.c_double)
        self.c.applied.restype = kind
        self.c.bytes.restype, self.c.size.restype = ctypes.c_size_t, ctypes.c_double
        self.start = self.c.start
        self.start()

    def step(self, y: Any) -> tuple[int, Any]:
        read, u = np.ascontiguousarray(y, dtype=self.real), np.full(self.m, 7e37, self.real)
        code = self.c.step(read.ctypes.data_as(ctypes.c_void_p), u.ctypes.data_as(ctypes.c_void_p))
        return code, u

    def aim(self, target: Any) -> int:
        rows = np.ascontiguousarray(target, dtype=self.real)
        return int(self.c.target(rows.ctypes.data_as(ctypes.c_void_p)))


def system(rng: Any, n: int, m: int, radius: float) -> tuple[Any, Any]:
    A = rng.standard_normal((n, n))
    A *= radius / np.abs(np.linalg.eigvals(A)).max()
    return A, rng.standard_normal((n, m))


def random_gain(rng: Any) -> Any:
    n, m = rng.integers(1, 7), rng.integers(1, 4)
    return se.gain(system(rng, n, m, rng.uniform(0.5, 1.3)), 1.0, 10.0 ** rng.uniform(-2, 2))


def random_plans(rng: Any, rates: bool, states: bool = False) -> Any:
    n, m, K = rng.integers(1, 6), rng.integers(1, 4), int(rng.integers(1, 16))
    A, B = system(rng, n, m, rng.uniform(0.5, 1.15))
    high = rng.uniform(0.2, 2.0, m)
    low = np.where(rng.random(m) < 0.2, -np.inf, -rng.uniform(0.2, 2.0, m))
    how: Any = {"Q": rng.uniform(0.1, 2.0, n), "R": 10.0 ** rng.uniform(-2, 1)}
    target, within = rng.standard_normal(n) * 0.3, {}
    if rates:
        within = {"rate": rng.uniform(0.05, 1.0, m), "previous": np.zeros(m)}
    if states:
        top, bottom = rng.uniform(0.1, 1.0, (2, K, n))
        top[:, rng.random(n) < 0.3] = np.inf
        within |= {"x": (-bottom, top), "soft": [True, 30.0][rng.integers(2)]}
        how["reference"], target = np.cumsum(0.1 * rng.standard_normal((K + 1, n)), axis=0), None
    limits: Any = se.Limits(u=(low, high), **within)
    return se.regulate((A, B), K, target, limits=limits, cost=se.Cost(**how))


def random_readings(rng: Any, plans: bool, within: bool = False) -> Any:
    p, m = int(rng.integers(1, 3)), int(rng.integers(1, 3))
    lags, delay = int(rng.integers(1, 4)), int(rng.integers(0, 3))
    A1, A2 = system(rng, p, m, 0.8)[0], 0.1 * rng.standard_normal((p, p))
    B = rng.standard_normal((p, m))
    y, u = np.zeros((300, p)), rng.standard_normal((299, m))
    for t in range(delay + 1, 299):
        noise = 0.05 * rng.standard_normal(p)
        y[t + 1] = A1 @ y[t] + A2 @ y[t - 1] + B @ u[t - delay] + noise + 0.2
    if rng.random() < 0.4:
        window = se.Window(filters=(float(rng.uniform(0.2, 0.7)), lags), delay=delay)
    else:
        window = se.Window(lags=lags + 1, delay=delay)
    model = se.identify(se.Trajectories([y], [u], outputs=True), window=window, intercept=True)
    free: Any = [False, True, 0.05][rng.integers(3)]
    target = y.mean(axis=0) + 0.1
    if p > m:
        target[m:] = np.nan
    limits: Any = {"u": (-rng.uniform(0.5, 2.0, m), rng.uniform(0.5, 2.0, m))}
    if rng.random() < 0.5:
        limits |= {"rate": rng.uniform(0.1, 0.5, m), "previous": np.zeros(m)}
    if within:
        limits |= {"x": (y.min(axis=0) * 0.4, np.where(rng.random(p) < 0.3, np.inf, y.max() * 0.4))}
    limits = se.Limits(**limits)
    how: Any = {"limits": limits, "offset_free": free, "max_missing": int(rng.integers(0, 4))}
    if plans:
        cost = se.Cost(Q=np.ones(p), R=0.3)
        return se.regulate(model, int(rng.integers(2, 10)), target, cost=cost, **how)
    return se.regulate(se.gain(model, np.ones(p), 0.3), target=target, **how)


KINDS = {
    "gain": random_gain,
    "limits": lambda rng: random_plans(rng, False),
    "rates": lambda rng: random_plans(rng, True),
    "states": lambda rng: random_plans(rng, False, True),
    "states, rates": lambda rng: random_plans(rng, True, True),
    "readings": lambda rng: random_readings(rng, False),
    "readings, plans": lambda rng: random_readings(rng, True),
    "readings, within": lambda rng: random_readings(rng, True, True),
}
BROKEN = (np.nan, np.inf, -np.inf, 1e300, -1e200)
