"""Models and loops from readings beside other packages, and the time of a call.

    python benches/readings.py [models] [plans] [calls] [logs]

models: prediction of hidden systems with errors of reading beside N4SID of SLICOT, which is told
the order (`pip install ctrlsys`). plans: a loop that plans within limits beside one that plans from
the samples themselves (`pip install direct-data-driven-mpc`). calls: our loop for windows of p
lags. logs: a CSV file beside pandas. Medians, one thread; a package that is missing is named, and
its table left out.
"""

from __future__ import annotations

import importlib
import sys
import tempfile
import time
import timeit
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

import stochens_rs as se

Floats = NDArray[np.float64]
AHEAD = 10  # steps of a prediction
SAMPLES = 2000
START = 200  # of the first prediction


def peer(name: str, package: str) -> ModuleType | None:
    """The module, or None and a line that says what is missing."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        print(f"left out: `pip install {package}` is needed ({error})")
        return None


class Hidden:
    """x+ = A x + B u + w, y = C x + v: 2 to 4 states, 1 or 2 of them read with error."""

    def __init__(self, rng: np.random.Generator) -> None:
        n, p = int(rng.integers(2, 5)), int(rng.integers(1, 3))
        A = rng.standard_normal((n, n))
        self.A = A * rng.uniform(0.6, 0.98) / np.abs(np.linalg.eigvals(A)).max()
        self.B, self.C = rng.standard_normal((n, 1)), rng.standard_normal((p, n))
        sizes = (0.01, 0.3), (0.03, 1.0)
        self.process, self.sensor = (np.exp(rng.uniform(*np.log(ends))) for ends in sizes)

    def run(self, rng: np.random.Generator, feedback: float) -> tuple[Floats, Floats]:
        """Readings (SAMPLES + 1, p) and inputs; limited feedback from the readings, and chance."""
        x, K = rng.standard_normal(len(self.A)), rng.standard_normal((1, len(self.C)))
        y, u = [], []
        for _ in range(SAMPLES + 1):
            y.append(self.C @ x + self.sensor * rng.standard_normal(len(self.C)))
            u.append(np.clip(-feedback * K @ y[-1], -2.0, 2.0) + rng.standard_normal(1))
            x = self.A @ x + self.B @ u[-1] + self.process * rng.standard_normal(len(x))
        return np.array(y), np.array(u[:-1])

    def predictor(self) -> Predictor:
        """The steady Kalman filter."""
        A, C, P = self.A, self.C, np.eye(len(self.A))
        for _ in range(3000):
            L = A @ P @ C.T @ np.linalg.inv(C @ P @ C.T + self.sensor**2 * np.eye(len(C)))
            P = (A - L @ C) @ P @ A.T + self.process**2 * np.eye(len(A))
        return Predictor.innovations(A, self.B, C, L)


@dataclass(frozen=True)
class Predictor:
    """y(t+1) = C x(t) + D u(t), x+ = A x + B u, where x(t+1) = F x(t) + E u(t) + G y(t+1)."""

    A: Floats
    B: Floats
    C: Floats
    D: Floats
    F: Floats
    E: Floats
    G: Floats

    @classmethod
    def innovations(cls, A: Floats, B: Floats, C: Floats, L: Floats) -> Predictor:
        """Of x+ = A x + B u + L (y - C x)."""
        M = np.linalg.solve(A, L)
        keep = np.eye(len(A)) - M @ C
        return cls(A, B, C @ A, C @ B, keep @ A, keep @ B, M)

    @classmethod
    def window(cls, model: se.Model) -> Predictor:
        """Of a model of ours."""
        assert model.window is not None
        n, p, pole = model.n, model.n_outputs, model.window.pole or 0.0
        _, FE, G = model.window.loop(np.zeros((p, model.window.length)))
        C = (model.A[:p] - pole * np.eye(p, n)) / (1.0 - pole)
        return cls(model.A, model.B, C, model.B[:p] / (1.0 - pole), FE[:, :n], FE[:, n:], G)

    def predicted(self, y: Floats, u: Floats) -> Floats:
        """E(y(t + AHEAD) | y(1) .. y(t)), for t = START .."""
        x, states = np.zeros(len(self.A)), []
        for force, now in zip(u, y[1:], strict=True):
            x = self.F @ x + self.E @ force + self.G @ now
            states.append(x)
        x = np.array(states)[START - 1 : len(u) - AHEAD]
        for k in range(AHEAD - 1):
            x = x @ self.A.T + u[START + k : START + k + len(x)] @ self.B.T
        last = START + AHEAD - 1
        return x @ self.C.T + u[last : last + len(x)] @ self.D.T

    def effects(self) -> Floats:
        """What an input of 1 does to the outputs of the next 20 steps."""
        later = [self.C @ np.linalg.matrix_power(self.A, k) @ self.B for k in range(19)]
        return np.array([self.D, *later])


def n4sid(slicot: ModuleType, y: Floats, u: Floats, n: int, rows: int = 8) -> Predictor:
    """SLICOT's IB01AD and IB01BD, with the rows that predict best among 8 .. 25."""
    p, y, u = y.shape[1], np.asfortranarray(y[:-1]), np.asfortranarray(u)
    r = slicot.ib01ad("N", "Q", "N", "O", "N", "N", rows, 1, p, u, y, 0.0, -1.0)[1]
    A, C, B, _, _, _, _, L, _, info = slicot.ib01bd("N", "A", "K", rows, n, 1, p, len(u), r, 0.0)
    if info:
        raise ArithmeticError(f"IB01BD ends with {info}")
    return Predictor.innovations(A, B, C, L)


def compared(slicot: ModuleType, rng: np.random.Generator, feedback: float) -> list[list[float]]:
    """Of one system and each model: rms over the true one's, % of the effects missed, ms."""
    hidden = Hidden(rng)
    (y, u), (later, forces) = hidden.run(rng, feedback), hidden.run(rng, feedback)
    data, best = se.Trajectories([y], [u], outputs=True), hidden.predictor()
    works: list[Callable[[], Predictor]] = [
        lambda: n4sid(slicot, y, u, len(hidden.A)),
        lambda: Predictor.window(se.identify(data, checks=False)),
        lambda: Predictor.window(se.identify(data, window=se.Window(lags=12), checks=False)),
    ]

    def rms(model: Predictor) -> float:
        predicted = model.predicted(later, forces)
        return float(np.sqrt(np.mean((later[START + AHEAD :] - predicted) ** 2)))

    found = []
    for work in works:
        start = time.perf_counter()
        model = work()
        spent = time.perf_counter() - start
        missed = np.linalg.norm(model.effects() - best.effects()) / np.linalg.norm(best.effects())
        found.append([rms(model) / rms(best), 100.0 * missed, 1e3 * spent])
    return found


def models(count: int = 100) -> None:
    """Prediction over that of the true Kalman filter, on a fresh run."""
    slicot = peer("ctrlsys", "ctrlsys")
    if slicot is None:
        return
    names = "N4SID, order told", "ours", "ours, lags=12"
    for what, feedback, seed in (("inputs by chance", 0.0, 41), ("with feedback", 0.2, 42)):
        rngs = (np.random.default_rng([seed, number]) for number in range(count))
        table = np.array([compared(slicot, rng, feedback) for rng in rngs])
        middle, high = np.median(table, axis=0), np.quantile(table[:, :, 0], 0.9, axis=0)
        print(f"\n{what}: {count} systems, one run of {SAMPLES} samples, {AHEAD} steps ahead")
        print(
            "| model | rms over the true one's | 90 % of them | effects of inputs off by | time |"
        )
        print("|---|---:|---:|---:|---:|")
        for name, (ratio, missed, ms), most in zip(names, middle, high, strict=True):
            print(f"| {name} | {ratio:.4f} | {most:.4f} | {missed:.2f} % | {ms:.1f} ms |")


def after(x: Floats, force: float, rng: np.random.Generator) -> Floats:
    """The plant of the loops, one step later."""
    A, B = np.array([[0.9, 0.2], [-0.1, 0.95]]), np.array([0.1, 0.05])
    return A @ x + B * force + 0.003 * rng.standard_normal(2)


def logged(samples: int, seed: int) -> tuple[Floats, Floats]:
    """A run of it with inputs by chance."""
    rng, y = np.random.default_rng(seed), [np.zeros(2)]
    u = rng.uniform(-1.0, 1.0, (samples, 1))
    for force in u[:, 0]:
        y.append(after(y[-1], force, rng))
    return np.array(y), u


def plans(samples: int = 100, steps: int = 20, calls: int = 300) -> None:
    """A loop that plans within limits, beside one that plans from the samples themselves.

    Same plant, samples, horizon, weights, limits, start and noise; each is given the model order.
    """
    made = peer("direct_data_driven_mpc.lti_data_driven_mpc_controller", "direct-data-driven-mpc")
    if made is None:
        return
    low, high, weight = -0.5, 0.5, 0.1
    y, u = logged(samples, 2)
    model = se.identify(
        se.Trajectories([y], [u], outputs=True), window=se.Window(lags=2), checks=False
    )
    cost = se.Cost(Q=[1.0, 1.0], R=weight)
    ours = se.regulate(model, steps, limits=(low, high), cost=cost, offset_free=False)
    given = {"n": 2, "m": 1, "p": 2, "L": steps, "u_d": u, "y_d": y[:-1]}
    task = {"Q": np.eye(2 * steps), "R": weight * np.eye(steps), "U": np.array([[low, high]])}
    goal = {"u_s": np.zeros((1, 1)), "y_s": np.zeros((2, 1)), "use_terminal_constraints": False}
    # lamb_alpha: the least cost of the run among 0.001 .. 10
    noise = {"eps_max": 0.01, "lamb_alpha": 10.0, "lamb_sigma": 1e3, "c": 1.0}
    robust = {"controller_type": made.LTIDataDrivenMPCType.ROBUST}
    slack = {"slack_var_constraint_type": made.SlackVarConstraintType.NONE}
    theirs = made.LTIDataDrivenMPCController(**given, **task, **goal, **noise, **robust, **slack)

    def plan_from_samples(y: Floats) -> float:
        theirs.update_and_solve_data_driven_mpc()
        force = float(np.squeeze(theirs.get_optimal_control_input_at_step(0)))
        theirs.store_input_output_measurement(np.array([[force]]), y.reshape(2, 1))
        return force

    rows = []
    for act in (lambda y: float(ours(y)[0]), plan_from_samples):
        rng, x, spent, forces, paid = np.random.default_rng(3), np.array([2.0, -1.0]), [], [], 0.0
        for _ in range(calls):
            start = time.perf_counter()
            forces.append(act(x))
            spent.append(time.perf_counter() - start)
            paid += x @ x + weight * forces[-1] ** 2
            x = after(x, forces[-1], rng)
        rows.append((np.median(spent), paid, sum(abs(u) > high - 1e-3 for u in forces)))
    print(f"\nplans of {steps} steps, {samples} samples, {calls} calls; input {low} .. {high}")
    print("| loop | time of a call | ratio | cost of the run | calls at a limit |")
    print("|---|---:|---:|---:|---:|")
    for name, (spent, paid, at) in zip(("ours", "from the samples"), rows, strict=True):
        print(f"| {name} | {1e6 * spent:.0f} us | {spent / rows[0][0]:.0f}x | {paid:.2f} | {at} |")


def calls() -> None:
    """Our loop with a gain, and with plans, for windows of p lags."""
    y, u = logged(2000, 1)
    data = se.Trajectories([y], [u], outputs=True)
    print("\n| lags | states | gain, us | plan of 20 steps, us |")
    print("|---:|---:|---:|---:|")
    for lags in (4, 8, 16):
        model = se.identify(data, window=se.Window(lags=lags), checks=False)
        times = []
        for made, steps in ((se.gain(model, 1.0, 1.0), None), (model, 20)):
            loop = se.regulate(made, steps, limits=(-1.0, 1.0), offset_free=True)
            for row in y[:1000]:
                loop(row)
            times.append(1e6 * np.median([call.seconds for call in loop.log[-900:]]))
        print(f"| {lags} | {model.n} | {times[0]:.1f} | {times[1]:.1f} |")


def logs(rows: int = 40_000) -> None:
    """A CSV file of five columns as runs, beside the columns of pandas."""
    pandas, gen = peer("pandas", "pandas"), np.random.default_rng(1)
    columns = np.column_stack([0.02 * np.arange(rows), gen.standard_normal((rows, 4))])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        np.savetxt(path, columns, "%.17g", ",", header="t,p,v,w,F", comments="")

        def ours() -> None:
            se.Trajectories.from_csv(path, states=["p", "v", "w"], inputs=["F"], time="t")

        readers = {"ours": ours} | ({"pandas": lambda: pandas.read_csv(path)} if pandas else {})
        spent = {
            name: min(timeit.repeat(read, number=1, repeat=9)) for name, read in readers.items()
        }
    print(f"\na CSV file of {rows} rows and five columns")
    print("| reader | time | ratio |")
    print("|---|---:|---:|")
    for name, one in spent.items():
        print(f"| {name} | {1e3 * one:.1f} ms | {one / min(spent.values()):.1f}x |")


if __name__ == "__main__":
    tables = {"models": models, "plans": plans, "calls": calls, "logs": logs}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in sys.argv[1:] or tables:
            tables[name]()
