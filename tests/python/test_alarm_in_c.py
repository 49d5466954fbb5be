"""The alarm in the header of a controller is that of the core."""

from __future__ import annotations

import ctypes
import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import stochens_rs as se
from controllers import FLAGS, compiler
from coverage_study import sets
from hidden_outputs import one_log

pytestmark = [
    pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning"),
    pytest.mark.skipif(compiler() is None, reason="no gcc: controllers are not compiled"),
]
DRIVER = """#include "one.h"
static one_alarm a;
void start(void) { one_alarm_start(&a); }
void cleared(void) { a.alarm = 0.0; }
int look(const one_real *y, const one_real *u) { return one_look(&a, y, u); }
double *numbers(int which)
{
    static double counts[11];
    double all[11] = {a.calls, a.pairs, a.since, a.idle, a.skipped, a.alarms, a.alarm, a.level};
    for (int k = 0; k < 11; ++k)
        counts[k] = k < 8 ? all[k] : a.starts[k - 8];
    switch (which) {
    case 0: return counts;
    case 1: return a.x;
    case 2: return a.evidence;
    case 3: return a.estimates;
    case 4: return a.sums[0];
    case 5: return a.sums[1];
    case 6: return a.squares[1];
    default: return a.sizes[1];
    }
}
"""
STATUS = ("quiet", "alarm", "skipping", "blind")


class Alarm:
    """The compiled alarm of `one.h`."""

    def __init__(self, folder: Path, more: tuple[str, ...] = ()):
        (folder / "one.c").write_text(DRIVER)
        command = [compiler() or "gcc", *FLAGS, *more, "-fPIC", "-shared", "one.c"]
        name = f"alarm{len(more)}.so"
        done = subprocess.run(
            [*command, "-o", name, "-lm"], cwd=folder, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        self.c = ctypes.CDLL(str(folder / name))
        self.c.numbers.restype = ctypes.POINTER(ctypes.c_double)
        self.real: Any = np.float32 if "-DONE_FLOAT" in more else np.float64
        self.c.start()

    def look(self, y: Any, u: Any) -> str:
        rows = [np.ascontiguousarray(one, dtype=self.real) for one in (y, u)]
        return STATUS[self.c.look(*(row.ctypes.data_as(ctypes.c_void_p) for row in rows))]

    def numbers(self, which: int, size: int) -> Any:
        return np.array(self.c.numbers(which)[:size])


def of_states(rng: Any, still: bool = False) -> Any:
    n, m = int(rng.integers(1, 4)), int(rng.integers(1, 3))
    A, B = 0.8 * np.linalg.qr(rng.standard_normal((n, n)))[0], rng.standard_normal((n, m))
    x, w = rng.standard_normal((2, 80, n)) * 10.0 ** rng.uniform(-2, 2, n)
    u = rng.standard_normal((80, m))
    if still:
        u[:, -1] = 0.6
    size = 0.05 * x.std(axis=0)
    y = x @ A.T + u @ B.T + 0.05 * w / w.std(axis=0) * x.std(axis=0)
    data = se.Trajectories.from_pairs(x, u, y)
    model = se.identify(data, noise=se.Noise(covariance=np.diag(size**2)), intercept=still)
    loop = se.regulate(model, 3, limits=(-np.ones(m), np.ones(m)))
    return loop, se.gain(model, 1.0, 1.0).certificate() if not still else None, model


def of_readings(rng: Any, filters: bool, delay: int) -> Any:
    def ahead(y: Any, u: Any) -> Any:
        return 1.2 * y[-1] - 0.4 * y[-2] + u[-1 - delay] @ [1.0, 0.4]

    y, u = one_log(ahead, rng, sizes=(1, 2), noise=0.1, lags=delay + 2)
    window = se.Window(filters=(0.4, 3), delay=delay) if filters else se.Window(lags=2, delay=delay)
    data = se.Trajectories([y], [u], outputs=True)
    model = se.identify(data, window=window, noise=0.1, accept="memory" if filters else ())
    loop = se.regulate(se.gain(model, 1.0, 1.0), offset_free=True)
    return loop, loop.certificate(), model


MADE = {
    "states": lambda rng: of_states(rng),
    "an input that stands still": lambda rng: of_states(rng, still=True),
    "lags": lambda rng: of_readings(rng, False, 0),
    "lags, delay": lambda rng: of_readings(rng, False, 2),
    "filters": lambda rng: of_readings(rng, True, 0),
    "filters, delay": lambda rng: of_readings(rng, True, 1),
}


def followed(
    watch: Any, c: Alarm, rng: Any, steps: int, still: bool = False, model: Any = None
) -> tuple[Any, Any]:
    """Both alarms on records of a plant that changes, with readings that are missing.

    The plant of a model is this model, but for 30 steps in 20 000.
    """
    source, n = watch.proof.source, len(watch.names[0])
    z = source.window
    x, off, statuses = np.zeros((z.count + z.delay, n)), 0.0, set()
    past = np.zeros((z.count + z.delay + 1, len(watch.names[1])))
    for t in range(steps):
        u = rng.standard_normal(past.shape[1])
        if still and rng.random() < 0.98:
            u[-1] = 0.6
        y = x[0].copy()
        if rng.random() < 0.01:
            y[rng.integers(n)] = [np.nan, np.inf, 1e30][rng.integers(3 if model is None else 2)]
        acted = past[0].copy()
        if rng.random() < 0.002:
            acted[0] = np.nan
        found = watch(y.astype(c.real).astype(float), u, applied=acted.astype(c.real).astype(float))
        status = c.look(y.astype(c.real), acted)
        statuses.add(found.status)
        assert status == found.status, t
        level = c.numbers(0, 8)[7]
        off = max(off, abs(level - found.evidence) / max(1.0, found.evidence))
        assert c.numbers(0, 8)[5] == found.alarms
        if t % 997 == 996:
            watch.clear()
            c.c.cleared()
        past = np.vstack([u, past[:-1]])
        effect = past[z.delay] * (0.5 if t > steps // 2 and t % 700 < 200 else 1.0)
        new = 0.6 * x[0] + 0.1 * x[-1] + effect.sum() * 0.3 + 0.1 * rng.standard_normal(n)
        if model is not None:
            acting = past[z.delay :][: z.count] * (0.3 if 10_000 <= t % 20_000 < 10_030 else 1.0)
            new = model.coefficients @ np.hstack([x[: z.count].ravel(), acting.ravel()])
            new = new + 0.8 * np.sqrt(np.diag(model.covariance)) * rng.standard_normal(n)
        x = np.vstack([new, x[:-1]])
    return off, statuses


LAWS: Any = (
    ("variance", False, {"every": 1e4}),
    ("gaussian", True, {"level": 0.01}),
    ("symmetric", False, {"every": 100.0}),
    ("bounded", False, {"level": 0.05}),
)


@pytest.mark.parametrize(
    ("kind", "law"),
    [*(("states", law) for law in LAWS), *((kind, LAWS[k % 2]) for k, kind in enumerate(MADE))][1:],
)
def test_the_alarm_is_that_of_the_core(kind: str, law: Any, tmp_path: Path) -> None:
    rng = np.random.default_rng([7, list(MADE).index(kind)])
    loop, proof, model = MADE[kind](rng)
    proof = proof or se.gain(model, 1.0, 1.0).certificate()
    loop.watch = proof.watch(law=law[0], moving=law[1], **law[2])
    if law[0] == "symmetric":  # beside a gain
        se.gain(model, 1.0, 1.0).to_c(tmp_path / "one.h", name="one", watch=loop.watch)
    else:
        loop.to_c(tmp_path / "one.h", name="one")
    c = Alarm(tmp_path)
    off, statuses = followed(loop.watch, c, rng, sets(2000, 1000), "still" in kind)
    assert off < 1e-12
    assert "alarm" in statuses
    assert "skipping" in statuses
    state, at = loop.watch.__getstate__()["state"], 15
    counts = [*state[:6], c.numbers(0, 7)[6], *state[7:11]]  # the call of an alarm, and whether
    np.testing.assert_allclose(c.numbers(0, 11), counts, rtol=1e-12)
    text = (tmp_path / "one.h").read_text("utf-8")
    size = {name: int(v) for name, v in re.findall(r"#define ONE_ALARM_(\w+) (\d+)", text)}
    for which, count in (
        (1, size["STATES"]),
        (None, size["P"]),
        (2, size["ALL"]),
        (3, 2 * size["ROWS"] * size["D"]),
        (4, 2 * size["BETS"] * size["SMALL"]),
        (5, 2 * size["BETS"] * size["SMALL"]),
        (None, 2 * size["BETS"] * size["SMALL"] * size["ANY"]),
        (None, size["BETS"]),
        (6, size["BETS"]),
        (None, size["BETS"]),
        (7, size["BETS"]),
    ):
        if which is not None:
            rows = c.numbers(which, count), state[at : at + count]
            np.testing.assert_allclose(*rows, rtol=1e-11, atol=1e-12)
        at += count


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["lags, delay", "states"][: sets(2, 1)])
def test_the_alarm_over_a_long_run(kind: str, tmp_path: Path) -> None:
    """A million steps, in `make test` 11 000: the plant changes behind 10 000."""
    rng = np.random.default_rng([8, list(MADE).index(kind)])
    loop, proof, model = MADE[kind](rng)
    loop.watch = (proof or se.gain(model, 1.0, 1.0).certificate()).watch(every=1e6)
    loop.to_c(tmp_path / "one.h", name="one")
    c = Alarm(tmp_path)
    steps = sets(1_000_000, 11_000)
    off, statuses = followed(loop.watch, c, rng, steps, model=model)
    assert off < 1e-9
    assert {"alarm", "quiet"} <= statuses
    assert c.numbers(0, 6)[5] < steps / 1000  # so that the evidence is that of long runs
    text = (tmp_path / "one.h").read_text("utf-8")
    count = int(re.search(r"ONE_ALARM_ALL (\d+)", text)[1])  # type: ignore[index]
    assert np.isfinite(c.numbers(2, count)).all()


def test_it_is_in_double_precision_in_any_case(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    loop, proof, _ = MADE["lags"](rng)
    loop.watch = proof.watch()
    loop.to_c(tmp_path / "one.h", name="one")
    head = (tmp_path / "one.h").read_text("utf-8").partition("*/")[0]
    assert "alarm: false alarms at most one in 1e+05 steps" in re.sub(r"\n \* +", " ", head)
    assert "one_look(&alarm, y, " in re.sub(r"\n \* +", " ", head)
    c = Alarm(tmp_path, ("-O2", "-DONE_FLOAT"))
    assert followed(loop.watch, c, rng, 1000)[0] < 1e-12


@pytest.mark.parametrize("table", ["centre", "spreads", "scaled", "weights"])
def test_another_number_makes_another_alarm(table: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    loop, proof, _ = MADE["states"](rng)
    loop.watch = proof.watch(every=1e12)
    loop.to_c(tmp_path / "one.h", name="one")
    text = (tmp_path / "one.h").read_text("utf-8")
    at = text.index("{\n    ", text.index(f" one_alarm_{table}[")) + 6
    (tmp_path / "one.h").write_text(f"{text[:at]}1e-7 + {text[at:]}", "utf-8")
    assert followed(loop.watch, Alarm(tmp_path), rng, 300)[0] > 1e-12
