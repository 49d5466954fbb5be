"""Section 5.2 of the paper: a reference is tracked in a large random system (figure 3)."""

from __future__ import annotations

import hashlib
import time
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._base import gate
from ..._base.progress import Progress, progress_bar
from ..._base.types import Fusion
from ...cases import random_system
from ...fusion.fusing import Method
from ...rng import Key, RngLike, as_key
from ...studies.curves import Panel
from ...studies.experiment import Experiment, log_grid
from ...studies.replicate import (
    FUSED,
    FUSIONS,
    LARGEST,
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
    required_size,
    zero_level,
)
from ...system import System
from ...theory import moments
from ...theory.exact import Best, best_control

Floats = NDArray[np.float64]


def tracking(
    *,
    rng: RngLike = None,
    replicates: int = 20,
    samples: int = 1000,
    sizes: ArrayLike | None = None,
    n: int = 100,
    m: int = 80,
    spectral_radius: float = 1.0,
    step_two: Literal["rolled", "reference"] = "rolled",
    tol: float = 1e-10,
    progress: Progress = None,
) -> Experiment:
    """Relative errors of the computed x(1) and x(2) against the number of samples.

    One Gaussian system, x(0) and the references x(1), x(2) are drawn from `rng`. In every
    replicate and for t = 0, 1 the entities x(t), x(t+1) and A are sampled afresh (never reused
    between steps: reuse would bias the mean), fused, and give ``u(t) = B+ (x(t+1)_hat - A_hat
    x(t)_hat)``.

    Parameters
    ----------
    rng : None, int, SeedSequence, Generator, BitGenerator or Key
        Source of all randomness; None draws a fresh key, which is kept on the result.
    replicates : int, default 20
        Independent repetitions with the same system and reference.
    samples : int, default 1000
        Realizations of each entity, per step and replicate.
    sizes : sequence of int, optional
        Sample counts at which errors are taken, increasing, at most `samples`; default: 16 on a
        log grid.
    n, m : int, default 100 and 80
        States and inputs. A is n x n (the paper prints n x m).
    spectral_radius : float, default 1.0
        The Gaussian A is scaled to it; the paper does not say how its A was scaled.
    step_two : {"rolled", "reference"}, default "rolled"
        What figure 3(b) shows. "rolled": ``x_comp(2) = A x_comp(1) + B u(1)``, so that the error
        of step one is carried on. "reference": ``x_comp(2) = A x(1) + B u(1)``, step two alone.
        The paper does not say which; the other one is kept as panel "3b-alternative".
    tol : float, default 1e-10
        Relative duality gap asked of the ALSE solves.
    progress : bool or callable, optional
        True: a bar on a terminal or in a notebook. A callable is called as
        ``progress(done, total)`` after each replicate.

    Returns
    -------
    Experiment
        Panels "3a", "3b" and "3b-alternative": ``||x_comp(t) - x_actual(t)|| / ||x_actual(t)||``,
        where x_actual is what the exact controls ``v(t) = B+ (x(t+1) - A x(t))`` reach by the
        same reading.

    Raises
    ------
    InputError
        A size, a choice or a parameter that cannot be used.

    Notes
    -----
    With ``e(t) = B (u(t) - v(t))``, independent for t = 0 and 1 and of mean zero under uniform
    weights: ``x_comp(1) - x_actual(1) = e(0)``, ``x_comp(2) - x_actual(2) = A e(0) + e(1)``
    rolled and ``e(1)`` from the reference. Hence the exact mean squares ``tr C_0`` and ``tr(A C_0
    A^T) + tr C_1``, ``C_t = Cov e(t)``. Keys: "system", "x0", "x1", "x2"; "replicate-r", below it
    "step-t", below it "x0", "xf", "A".

    Examples
    --------
    >>> from stochens_rs.paper import tracking
    >>> tracking(rng=1, replicates=2, samples=20, n=12, m=9).panel("3a").quantity
    'state x(1)'
    """
    start = time.perf_counter()
    key = as_key(rng)
    replicates = gate.size("replicates", replicates, maximum=10**6)
    samples = gate.size("samples", samples)
    grid = log_grid(samples) if sizes is None else gate.sizes("sizes", sizes, maximum=samples)
    n, m = gate.size("n", n), gate.size("m", m)
    tol = gate.positive("tol", tol)
    if progress is not None and not callable(progress):
        gate.flag("progress", progress)
    gate.choice("step_two", step_two, ("rolled", "reference"))

    spectral_radius = gate.positive("spectral_radius", spectral_radius, maximum=LARGEST)
    system = random_system(n, m, rng=key.child("system"), spectral_radius=spectral_radius)
    A, B = system.A, system.B
    x = [normal(key.child(f"x{t}"), n) for t in range(3)]
    best = [best_control(A, B, x[t], x[t + 1]) for t in range(2)]  # the exact controls
    actual = {
        "x1": best[0].reached,
        "rolled": A @ best[0].reached + best[1].pushed,
        "reference": best[1].reached,
    }

    errors, solves = Errors(replicates, grid), Solves()
    with progress_bar(progress, replicates, "tracking") as done:
        for r in range(replicates):
            # e[t] is (k, n) for every (method, fusion): the state error that step t adds.
            replicate = key.child(f"replicate-{r}")
            e = [
                _step(replicate.child(f"step-{t}"), A, best[t], x[t], x[t + 1], grid, tol, solves)
                for t in range(2)
            ]
            for pair in FUSED:
                first, second = e[0][pair], e[1][pair]
                parts = {"x1": first, "rolled": first @ A.T + second, "reference": second}
                for name, error in parts.items():
                    relative = np.linalg.norm(error, axis=1) / np.linalg.norm(actual[name])
                    errors.put(r, name, *pair, relative)
            done(r + 1)

    orders = _orders(system, x)
    exact: dict[str, dict[str | None, Exact]] = {
        name: {
            fusion: exact_moments(both, grid, float(np.linalg.norm(actual[name])))
            for fusion, both in by_fusion.items()
        }
        for name, by_fusion in orders.items()
    }
    panels = _panels(errors, exact, actual, step_two, zero_level(tol, solves))
    ten_percent = 0.1 * float(np.linalg.norm(actual["x1"]))
    facts: dict[str, Any] = {
        "reachability": [_reachability(one) for one in best],
        "alse": {"x(t), x(t+1), A": solves.to_dict(tol)},
        "ordering": {panel.name: ordering(panel) for panel in panels},
        "theory": agreement(panels, grid),
        # Samples of each entity for a relative rms of 10 % in x(1) under uniform weights.
        "samples_for_ten_percent": {
            fusion: required_size(both, ten_percent) for fusion, both in orders["x1"].items()
        },
    }
    settings = {
        "system": system.name,
        "n": n,
        "m": m,
        "replicates": replicates,
        "samples": int(grid[-1]),
        "sizes": grid.tolist(),
        "spectral_radius": float(spectral_radius),
        "step_two": step_two,
        "tol": tol,
        "system_sha256": hashlib.sha256(A.tobytes() + B.tobytes()).hexdigest(),
    }
    return Experiment(
        name="tracking",
        title="Tracking two reference states in a large random system",
        key=key.hex,
        settings=settings,
        sizes=grid,
        panels=panels,
        facts=facts,
        seconds=time.perf_counter() - start,
    )


def _step(
    key: Key,
    A: Floats,
    best: Best,
    start: Floats,
    end: Floats,
    sizes: NDArray[np.int64],
    tol: float,
    solves: Solves,
) -> dict[tuple[Method, Fusion], Floats]:
    """The state error ``B (u - v)`` of one step, (k, n) for every pair (method, fusion)."""
    x0 = Entity.draw(start, sizes, key.child("x0"), tol, solves)
    xf = Entity.draw(end, sizes, key.child("xf"), tol, solves)
    sampled_A = Entity.draw(A, sizes, key.child("A"), tol, solves)
    B = best.factors.B
    u = controls(B, best.factors.inverse, x0, xf, sampled_A, sizes)
    return {pair: (u[pair] - best.u) @ B.T for pair in FUSED}


def _reachability(best: Best) -> dict[str, float]:
    """What the exact control leaves of ``x(t+1) - A x(t)``, absolute and relative."""
    residual = float(np.linalg.norm(best.needed - best.pushed))
    return {"residual": residual, "relative": residual / float(np.linalg.norm(best.needed))}


def _orders(system: System, x: list[Floats]) -> dict[str, dict[Fusion, tuple[Floats, Floats]]]:
    """``C1`` and ``C2`` of the state error ``C1 / N + C2 / N^2``: name -> fusion -> both."""
    A = system.A
    orders: dict[str, dict[Fusion, tuple[Floats, Floats]]] = {
        "x1": {},
        "rolled": {},
        "reference": {},
    }
    for fusion in FUSIONS:
        first, second = (
            both_orders(partial(_state, system, x[t], x[t + 1], fusion)) for t in range(2)
        )
        orders["x1"][fusion] = first
        orders["rolled"][fusion] = (
            A @ first[0] @ A.T + second[0],
            A @ first[1] @ A.T + second[1],
        )
        orders["reference"][fusion] = second
    return orders


def _state(system: System, start: Floats, end: Floats, fusion: Fusion, N: int) -> Floats:
    """Covariance of the state error that one step adds."""
    return moments.state_covariance(system, start, end, N, fusion=fusion)


def _panels(
    errors: Errors,
    exact: dict[str, dict[str | None, Exact]],
    actual: dict[str, Floats],
    step_two: str,
    solver_level: float,
) -> tuple[Panel, ...]:
    """Figure 3(a), 3(b) and, for the table, the other reading of 3(b)."""
    other = "reference" if step_two == "rolled" else "rolled"
    reading = {
        "rolled": "state x(2), rolled from the computed x(1)",
        "reference": "state x(2), from the reference x(1)",
    }
    rows = (
        ("3a", "3", "x1", "state x(1)"),
        ("3b", "3", step_two, reading[step_two]),
        ("3b-alternative", None, other, reading[other]),
    )
    symbol = r"$\|x_{\rm comp} - x_{\rm actual}\| \,/\, \|x_{\rm actual}\|$"
    return tuple(
        Panel(
            name=name,
            figure=figure,
            quantity=quantity,
            symbol=symbol,
            norm=float(np.linalg.norm(actual[source])),
            zero_level=solver_level,
            zero_label="zero to solver tolerance",
            curves=errors.curves(source, exact[source]),
        )
        for name, figure, source, quantity in rows
    )
