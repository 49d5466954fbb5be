"""Plants logged with feedback, their models near a reference, and what runs of plans then do."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

import stochens_rs as se
from hidden_outputs import Arx

Array = np.ndarray


def courses(model: se.Model, plan: se.Plan, K: Array | None) -> tuple[Any, Any]:
    """The plan and the reference as `_core.Pilot.followed` takes them."""
    pilot, m = model.pilot, plan.u.shape[1]
    assert pilot is not None
    given = (
        (model.coefficients, plan.predicted_states[0], plan.u, K),
        (pilot.model, pilot.start, pilot.inputs, pilot.follow),
    )
    found = []
    for Theta, x0, u, gain in given:
        J, ABc, G = map(np.ascontiguousarray, model.regressors.loop(Theta))
        found.append(((ABc, J, G, m), x0, u, gain))
    return found[0], found[1]


class Case(NamedTuple):
    """A plant ``y+ = Theta z + w`` and how it is logged: the first k runs are the pilot's."""

    Theta: Array
    covariance: Array
    log: Callable[[np.random.Generator], se.Trajectories]
    k: int
    task: tuple[Any, ...]  # x0, xf of states; a record of outputs
    steps: int
    weights: tuple[Any, Any]  # of the gain
    known: bool = True
    lags: int = 0
    intercept: bool = False
    filters: tuple[float, int] | None = None  # in place of lags: then Theta is not the truth

    def options(self) -> dict[str, Any]:
        window = {"window": se.Window(lags=self.lags)} if self.lags else {}
        if self.filters is not None:
            window = {"window": se.Window(filters=self.filters)}
        noise = {"noise": se.Noise(covariance=self.covariance)} if self.known else {}
        return {"checks": False, "intercept": self.intercept, **window, **noise}

    def plan(self, model: se.Model) -> se.Plan:
        if self.lags:
            return se.control(model, record=self.task, steps=self.steps)
        return se.control(model, *self.task, steps=self.steps)

    def models(self, data: se.Trajectories, followed: bool = True, **options: Any) -> se.Model:
        """The model near what the first runs say of the task."""
        options = {**self.options(), **options}
        first = se.identify(data[: self.k], **options)
        gain = se.gain(first, *self.weights) if followed else None
        near = se.Pilot(self.k, inputs="any", reference=self.plan(first), gain=gain)
        return se.identify(data, pilot=near, **options)

    def plain(self, data: se.Trajectories) -> se.Model:
        return se.identify(data, **self.options())

    def run(
        self, model: se.Model, plan: se.Plan, K: Array, root: Array, gen: np.random.Generator | None
    ) -> Array:
        """How far states or readings are from the plan, (steps, p), followed with K (m, n)."""
        p, ahead = len(self.Theta), plan.predicted_states
        J, ABc, G = model.regressors.loop(self.Theta)
        x, off, one = ahead[0], np.zeros((self.steps, p)), np.ones(int(self.intercept))
        for k, u in enumerate(plan.u):
            z = np.concatenate([x, u + K @ (x - ahead[k]), one])
            w = np.zeros(p) if gen is None else root @ gen.standard_normal(p)
            planned = model.coefficients @ J @ np.concatenate([ahead[k], u, one])
            off[k] = self.Theta @ J @ z + w - planned
            x = ABc @ z + G @ w
        return off


def states(
    A: Any, B: Any, sigma: Any, gain: Any, *, dither: float = 1.0, clip: float = np.inf,
    runs: int = 20, length: int = 12, steps: int = 6, known: bool = True,
    units: Any = 1.0, starts: str = "free", weights: tuple[Any, Any] = (1.0, 0.3),
    offset: Any = None,
) -> Case:  # fmt: skip
    """States under a clipped gain and dither; `starts`: free, or as earlier runs ended."""
    A, B, gain = (np.atleast_2d(np.asarray(one, dtype=float)) for one in (A, B, gain))
    n, m = B.shape
    units = np.broadcast_to(units, n)
    A, B, gain = A * units[:, None] / units, B * units[:, None], gain / units
    deviations, c = units * sigma, units * (0.0 if offset is None else np.array(offset))

    def log(gen: np.random.Generator) -> se.Trajectories:
        X, U = [], []
        for _ in range(runs):
            x = 0.5 * units * gen.standard_normal(n)
            if starts == "ended" and X:
                last = X[-1][-1]  # what went well goes on, the rest starts again where it began
                x = last if np.linalg.norm(last / units) < 0.3 else -0.5 * X[-1][0]
            xs, us = [x], []
            for _ in range(length):
                us.append(np.clip(gain @ x, -clip, clip) + dither * gen.standard_normal(m))
                x = A @ x + B @ us[-1] + c + deviations * gen.standard_normal(n)
                xs.append(x)
            X.append(np.array(xs))
            U.append(np.array(us))
        return se.Trajectories(X, U)

    task = units * np.linspace(1.0, -0.5, n), np.zeros(n)
    Q, R = weights
    weights = list(Q / units**2), R
    k = max(runs // 4, -(-3 * (n + m) // length))
    S = np.diag(deviations**2)
    Theta = np.hstack([A, B] if offset is None else [A, B, c[:, None]])
    return Case(Theta, S, log, k, task, steps, weights, known, intercept=offset is not None)


def outputs(seed: int, *, runs: int = 16, length: int = 30, steps: int = 8, known: bool) -> Case:
    """A hidden ARX under its own clipped feedback, over its own lags."""
    plant = Arx(np.random.default_rng(seed))
    y, u = plant.run(plant.lags + 20, np.random.default_rng([seed, 1]))

    def log(gen: np.random.Generator) -> se.Trajectories:
        return plant.data(runs, length, gen)

    Theta = np.hstack([*plant.A, *plant.B])
    return Case(
        Theta, plant.L @ plant.L.T, log, runs // 4, (y, u), steps, (1.0, 1.0), known, plant.lags
    )


UNSTABLE = [[1.15, 0.3], [0.0, 0.7]], [[0.3], [1.0]]
CASES: dict[str, Callable[[], Case]] = {
    "unit root": lambda: states(1.0, 0.5, 0.1, -0.4),
    "clipped": lambda: states(1.15, 1.0, 0.2, -0.6, clip=1.0),
    "unstable": lambda: states(*UNSTABLE, 0.1, [[-0.6, -0.3]]),
    "unstable, unknown": lambda: states(*UNSTABLE, 0.1, [[-0.6, -0.3]], known=False),
    "units": lambda: states(*UNSTABLE, 0.1, [[-0.6, -0.3]], units=[1e-3, 1e3]),
    "starts": lambda: states(*UNSTABLE, 0.1, [[-0.6, -0.3]], starts="ended"),
    "offset": lambda: states(*UNSTABLE, 0.1, [[-0.6, -0.3]], offset=[0.1, -0.2]),
    "readings": lambda: outputs(1, known=True),
    "readings, unknown": lambda: outputs(1, known=False),
    "more lags": lambda: outputs(11, known=False),
}
