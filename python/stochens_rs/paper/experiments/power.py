"""Section 5.1 of the paper: a power network, one step towards the origin (figures 1 and 2)."""

from __future__ import annotations

import hashlib
import time
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._base import gate
from ..._base.progress import Progress, progress_bar
from ..._base.types import Fusion
from ...cases import ieee14, ieee39
from ...exceptions import InputError
from ...rng import Key, RngLike, as_key
from ...studies.curves import Panel
from ...studies.experiment import Experiment, log_grid
from ...studies.replicate import (
    FUSED,
    FUSIONS,
    LARGEST,
    METHODS,
    ROUNDING,
    Entity,
    Errors,
    Exact,
    Solves,
    agreement,
    both_orders,
    controls,
    exact_moments,
    normal,
    ordering,
    slse_over_bound,
    zero_from,
    zero_level,
)
from ...system import System
from ...theory import moments
from ...theory.exact import Best, best_control
from .facts import counterexamples, printed_stopping_rule

Floats = NDArray[np.float64]


def power(
    *,
    rng: RngLike = None,
    replicates: int = 100,
    samples: int = 1000,
    sizes: ArrayLike | None = None,
    case: Literal["ieee14", "ieee39"] = "ieee14",
    data: Literal["classic", "andes"] = "classic",
    base: Literal["system", "machine"] = "system",
    dt: float = 0.01,
    method: Literal["zoh", "euler"] = "zoh",
    angle_std: float = 0.1,
    speed_std: float = 0.1,
    tol: float = 1e-10,
    progress: Progress = None,
) -> Experiment:
    """Errors of the estimates of x0 and A, of the control and of the state, against the number of
    samples.

    One random x0 and one system are drawn from `rng`; every replicate samples x0, x_f = 0 and A
    afresh and fuses the first 1, 2, ... of these samples by uniform weights, ALSE, SLSE and
    safeguarded SLSE. The control is ``u = B+ (xf_hat - A_hat x0_hat)`` (product fusion), for
    uniform weights also the mean of the per-realization controls (diagonal fusion), as in the
    paper.

    Parameters
    ----------
    rng : None, int, SeedSequence, Generator, BitGenerator or Key
        Source of all randomness; None draws a fresh key, which is kept on the result.
    replicates : int, default 100
        Independent repetitions with the same x0 and system.
    samples : int, default 1000
        Realizations N of each entity in every replicate.
    sizes : sequence of int, optional
        Sample counts at which errors are taken, increasing, at most `samples`; default: 16 on a
        log grid.
    case : {"ieee14", "ieee39"}
        IEEE 14-bus (n = 10, m = 5) or 39-bus (n = 20, m = 10) network.
    data, base, dt, method
        Passed to :func:`stochens_rs.cases.ieee14`; `data` and `base` have no meaning for "ieee39".
    angle_std, speed_std : float, default 0.1
        Standard deviations of the Gaussian x0: rotor angles [rad], speed deviations [rad/s]. A
        common factor changes no relative error.
    tol : float, default 1e-10
        Relative duality gap asked of the ALSE solves; relative errors of A below ``sqrt(tol)``
        cannot be told from zero.
    progress : bool or callable, optional
        True: a bar on a terminal or in a notebook. A callable is called as
        ``progress(done, total)`` after each replicate.

    Returns
    -------
    Experiment
        Panels "1a" (x0), "1b" (A, Frobenius norm), "2a" (control, ``||u - v*|| / ||v*||``) and
        "2b" (state, ``||B (u - v*)|| / ||x_actual||`` with ``x_actual = A x0 + B v*``: the origin
        itself has no relative error, and one step does not reach it).

    Raises
    ------
    InputError
        A size, a choice or a parameter that cannot be used.

    Notes
    -----
    The exact values for uniform weights are the second moments of
    :mod:`stochens_rs.theory.moments`; the paper has none. Keys: "x0" for the initial state;
    "replicate-r" for replicate r, and below it "x0", "xf", "A" for the samples.

    Examples
    --------
    >>> from stochens_rs.paper import power
    >>> result = power(rng=1, replicates=2, samples=50)
    >>> [panel.name for panel in result.panels]
    ['1a', '1b', '2a', '2b']
    """
    start = time.perf_counter()
    key = as_key(rng)
    replicates = gate.size("replicates", replicates, maximum=10**6)
    samples = gate.size("samples", samples)
    grid = log_grid(samples) if sizes is None else gate.sizes("sizes", sizes, maximum=samples)
    angle_std, speed_std = (
        gate.positive("angle_std", angle_std, maximum=LARGEST),
        gate.positive("speed_std", speed_std, maximum=LARGEST),
    )
    tol = gate.positive("tol", tol)
    if progress is not None and not callable(progress):
        gate.flag("progress", progress)
    system = _system(case, data, base, dt, method)

    x0 = normal(key.child("x0"), system.n) * np.repeat([angle_std, speed_std], system.n // 2)
    problem = _Problem(system, x0, np.zeros(system.n))

    errors, solves = Errors(replicates, grid), {"x0": Solves(), "A": Solves()}
    keys = [key.child(f"replicate-{r}") for r in range(replicates)]
    with progress_bar(progress, replicates, "power network") as done:
        for r, replicate in enumerate(keys):
            _run(r, replicate, problem, grid, tol, errors, solves)
            done(r + 1)

    panels = _panels(problem, errors, grid, zero_level(tol, solves["A"]))
    residual = float(np.linalg.norm(problem.xf - problem.x_actual))  # (I - B B+)(xf - A x0)
    facts: dict[str, Any] = {
        "reachability": {
            "residual": residual,
            "relative": residual / float(np.linalg.norm(problem.best.needed)),
            "rank": len(problem.best.factors.s),
        },
        "alse": {name: s.to_dict(tol) for name, s in solves.items()},
        "ordering": {panel.name: ordering(panel) for panel in panels},
        "theory": agreement(panels, grid),
        "slse_mean_square_over_bound": {p.name: slse_over_bound(p, grid) for p in panels[:2]},
        "zero_from": {p.name: zero_from(p, grid) for p in panels[:2]},
        "smallest_slse_error": {
            p.name: float(p.curve("slse").errors[:, -1].min()) for p in panels[:2]
        },
        "stopping_rule": printed_stopping_rule(
            x0, [k.child("x0") for k in keys], min(samples, 200)
        ),
        "counterexamples": counterexamples(),
    }
    settings = {
        "system": system.name,
        "n": system.n,
        "m": system.m,
        "replicates": replicates,
        "samples": int(grid[-1]),
        "sizes": grid.tolist(),
        "case": case,
        "data": data,
        "base": base,
        "dt": float(dt),
        "method": method,
        "angle_std": angle_std,
        "speed_std": speed_std,
        "tol": tol,
        "x0": x0.tolist(),
        "system_sha256": hashlib.sha256(system.A.tobytes() + system.B.tobytes()).hexdigest(),
    }
    return Experiment(
        name="power",
        title="Power network, one step to the origin",
        key=key.hex,
        settings=settings,
        sizes=grid,
        panels=panels,
        facts=facts,
        seconds=time.perf_counter() - start,
    )


@dataclass(frozen=True)
class _Problem:
    """The exact one-step problem and its solution."""

    system: System
    x0: Floats
    xf: Floats

    @cached_property
    def best(self) -> Best:
        """The exact control ``v = B+ (xf - A x0)``, and what it does."""
        return best_control(self.system.A, self.system.B, self.x0, self.xf)

    @property
    def v(self) -> Floats:
        """The exact control."""
        return self.best.u

    @property
    def x_actual(self) -> Floats:
        """Where it leads, ``A x0 + B v``: the reachable state nearest to xf."""
        return self.best.reached


def _system(case: str, data: str, base: str, dt: float, method: str) -> System:
    """The chosen network; its own options are checked by `cases`."""
    gate.choice("case", case, ("ieee14", "ieee39"))
    if case == "ieee14":
        return ieee14(data=data, base=base, dt=dt, method=method)  # type: ignore[arg-type]
    if (data, base) != ("classic", "system"):
        raise InputError(
            '`data` and `base` choose between IEEE 14-bus data: "ieee39" has one set only'
        )
    return ieee39(dt=dt, method=method)  # type: ignore[arg-type]


def _run(
    r: int,
    key: Key,
    problem: _Problem,
    sizes: NDArray[np.int64],
    tol: float,
    errors: Errors,
    solves: dict[str, Solves],
) -> None:
    """Replicate r: draw and fuse the three entities, enter the errors of all four panels."""
    p = problem
    exact_A, B = p.system.A, p.system.B
    x0 = Entity.draw(p.x0, sizes, key.child("x0"), tol, solves["x0"])
    xf = Entity.draw(p.xf, sizes, key.child("xf"), tol, Solves())  # zero: so is every sample
    A = Entity.draw(exact_A, sizes, key.child("A"), tol, solves["A"])
    for method in METHODS:
        errors.put(r, "1a", method, None, x0.errors[method] / np.linalg.norm(p.x0))
        errors.put(r, "1b", method, None, A.errors[method] / np.linalg.norm(exact_A))
    u = controls(B, p.best.factors.inverse, x0, xf, A, sizes)
    for method, fusion in FUSED:
        difference = u[method, fusion] - p.v
        control = np.linalg.norm(difference, axis=1) / np.linalg.norm(p.v)
        state = np.linalg.norm(difference @ B.T, axis=1) / np.linalg.norm(p.x_actual)
        errors.put(r, "2a", method, fusion, control)
        errors.put(r, "2b", method, fusion, state)


def _panels(
    p: _Problem, errors: Errors, sizes: NDArray[np.int64], solver_level: float
) -> tuple[Panel, ...]:
    """The four panels, with what theory says about uniform weights."""

    def x0(_: Fusion, N: int) -> Floats:
        return moments.vector_covariance(p.x0, N)

    def A(_: Fusion, N: int) -> Floats:  # its columns are independent: one block each
        return np.array([moments.vector_covariance(column, N) for column in p.system.A.T])

    def control(fusion: Fusion, N: int) -> Floats:
        return moments.control_covariance(p.system, p.x0, p.xf, N, fusion=fusion)

    def state(fusion: Fusion, N: int) -> Floats:
        return moments.state_covariance(p.system, p.x0, p.xf, N, fusion=fusion)

    rows = (
        ("1a", "initial state", r"$\|\hat x_0 - x_0\| \,/\, \|x_0\|$", p.x0, x0),
        ("1b", "system matrix", r"$\|\hat A - A\|_F \,/\, \|A\|_F$", p.system.A, A),
        ("2a", "control", r"$\|u - v^*\| \,/\, \|v^*\|$", p.v, control),
        (
            "2b",
            "state after one step",
            r"$\|B(u - v^*)\| \,/\, \|x_{\rm actual}\|$",
            p.x_actual,
            state,
        ),
    )
    panels = []
    for name, quantity, symbol, target, covariance in rows:
        norm = float(np.linalg.norm(target))
        exact: dict[str | None, Exact] = {
            fusion: exact_moments(both_orders(partial(covariance, fusion)), sizes, norm)
            for fusion in FUSIONS
        }
        exact[None] = exact["product"]  # an estimate has no fusion
        # Weights for x0 have a closed form; everything else depends on a solve for those of A.
        level, label = (
            (ROUNDING, "zero to rounding")
            if name == "1a"
            else (solver_level, "zero to solver tolerance")
        )
        panels.append(
            Panel(name, name[0], quantity, symbol, norm, level, label, errors.curves(name, exact))
        )
    return tuple(panels)
