"""Section 5.1 of the paper: a power network, one step towards the origin (figures 1 and 2)."""

from __future__ import annotations

import inspect
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._base import gate
from ..._base.numbers import ROUNDING
from ..._base.progress import Progress
from ..._base.types import FUSIONS
from ...cases import CASES
from ...ensembles.sampling import sample
from ...exceptions import InputError
from ...fusion.paths import fuse_path
from ...rng import Key, RngLike
from ...studies.curves import Panel
from ...studies.experiment import Experiment
from ...studies.experiment_run import LARGEST, Errors, ExperimentRun, Quantity, both_orders
from ...studies.methods import METHODS
from ...studies.replicate import Solves, Step
from ...system import System
from ...theory import moments

Floats = NDArray[np.float64]


def power(
    *,
    rng: RngLike = None,
    replicates: int = 100,
    samples: int = 1000,
    sizes: ArrayLike | None = None,
    case: str = "ieee14",
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
    case : str, default "ieee14"
        One of ``stochens_rs.cases.CASES``: the IEEE 14-bus network (n = 10, m = 5), or "ieee39",
        the 39-bus network (n = 20, m = 10).
    data, base, dt, method
        Options of the case, as in :func:`stochens_rs.cases.ieee14`. "ieee39" has no `data` and no
        `base`.
    angle_std, speed_std : float, default 0.1
        Standard deviations of the Gaussian x0: rotor angles [rad], speed deviations [rad/s]. A
        common factor changes no relative error.
    tol : float, default 1e-10
        Relative duality gap asked of the ALSE solves; relative errors of A below ``sqrt(tol)``
        count as zero.
    progress : None, bool or callable, optional
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
    study = ExperimentRun(rng, replicates, samples, sizes, tol)
    angle_std = gate.positive("angle_std", angle_std, maximum=LARGEST)
    speed_std = gate.positive("speed_std", speed_std, maximum=LARGEST)
    options = {"data": data, "base": base, "dt": dt, "method": method}
    system = _system(case, options)
    A, B, n = system.A, system.B, system.n
    scale = np.repeat([angle_std, speed_std], n // 2)
    x0, xf = study.key.child("x0").generator().standard_normal(n) * scale, np.zeros(n)
    step, solves = Step(A, B, x0, xf), {"x0": Solves(), "A": Solves()}

    def replicate(key: Key) -> Errors:
        drawn, controls = step.draw(key, study.sizes, study.tol, solves)
        errors: Errors = {}
        for method in METHODS:
            errors["1a", method, None] = drawn["x0"].errors[method]
            errors["1b", method, None] = drawn["A"].errors[method]
        for (method, fusion), error in controls.items():
            errors["2a", method, fusion] = np.linalg.norm(error, axis=1)
            errors["2b", method, fusion] = np.linalg.norm(error @ B.T, axis=1)
        return errors

    study.run("power network", replicate, progress)

    def columns(N: int) -> Floats:  # independent: one block each
        return np.array([moments.vector_covariance(column, N) for column in A.T])

    def fused(covariance: Any) -> dict[Any, Any]:
        return {f: both_orders(partial(covariance, system, x0, xf, fusion=f)) for f in FUSIONS}

    v, reached = step.exact.u, step.exact.reached
    vector = {None: both_orders(partial(moments.vector_covariance, x0))}
    matrix = {None: both_orders(columns)}
    control, state = fused(moments.control_covariance), fused(moments.state_covariance)
    panels = tuple(
        study.panel(Quantity(name, name[0], *shown))
        for name, *shown in (
            ("1a", "initial state", r"$\|\hat x_0 - x_0\| \,/\, \|x_0\|$", x0, vector, None),
            ("1b", "system matrix", r"$\|\hat A - A\|_F \,/\, \|A\|_F$", A, matrix, solves["A"]),
            ("2a", "control", r"$\|u - v^*\| \,/\, \|v^*\|$", v, control, solves["A"]),
            (
                "2b",
                "state after one step",
                r"$\|B(u - v^*)\| \,/\, \|x_{\rm actual}\|$",
                reached,
                state,
                solves["A"],
            ),
        )
    )
    estimates = panels[:2]
    facts: dict[str, Any] = {
        "reachability": {**step.unreachable(), "rank": int(np.linalg.matrix_rank(B))},
        "slse_mean_square_over_bound": {
            p.name: _slse_over_bound(p, study.sizes) for p in estimates
        },
        "zero_from": {p.name: _zero_from(p, study.sizes) for p in estimates},
        "smallest_slse_error": {
            p.name: float(p.curve("slse").errors[:, -1].min()) for p in estimates
        },
        "stopping_rule": _printed_stopping_rule(
            x0, [key.child("x0") for key in study.keys], min(int(samples), 200)
        ),
    }
    settings = {
        "case": case,
        **options,
        "dt": float(dt),
        "angle_std": angle_std,
        "speed_std": speed_std,
        "x0": x0.tolist(),
    }
    title = "Power network, one step to the origin"
    return study.experiment("power", title, system, panels, solves, facts, settings)


def _system(case: str, options: dict[str, Any]) -> System:
    """The chosen network; an option that it does not have must be left at its default."""
    made = CASES[gate.choice("case", case, tuple(CASES))]
    known, defaults = (inspect.signature(one).parameters for one in (made, power))
    for name, value in options.items():
        if name not in known and value != defaults[name].default:
            raise InputError(
                f"`{name}` must be left out with case {case!r}, which has no such option, "
                f"got {gate.show(value)}"
            )
    return made(**{name: value for name, value in options.items() if name in known})


def _zero_from(panel: Panel, sizes: NDArray[np.int64]) -> int | None:
    """The smallest size from which on all errors of ALSE are zero (to the panel's level)."""
    zero = np.all(panel.curve("alse").errors <= panel.zero_level, axis=0)
    steady = np.logical_and.accumulate(zero[::-1])[::-1]
    return int(sizes[np.argmax(steady)]) if steady.any() else None


def _slse_over_bound(panel: Panel, sizes: NDArray[np.int64]) -> float:
    """Largest ratio, over the sizes from 2 on, of SLSE's mean square to the exact one of uniform
    weights.

    At most 1 in expectation (Lemma 4.5, corrected: ``E d_n^2 <= V / n``); at n = 1 both are the
    same sample.
    """
    exact = panel.curve("uniform").exact_rms
    assert exact is not None  # uniform weights have one
    later = sizes >= min(2, sizes[-1])
    return float(np.max((panel.curve("slse").rms[later] / exact[later]) ** 2))


def _printed_stopping_rule(x0: Floats, keys: list[Key], steps: int) -> dict[str, Any]:
    """Where Algorithm 1's printed test would stop while it refines x0, and the error at that step.

    The printed ``error = ||(w1 - 1) v + w2 v'||`` is the length of the last change. A sample that
    does not help gets weight 0, the change is 0, and the loop ends for every positive error
    bound. For each key the SLSE estimate of x0 is followed, for at most `steps` samples, until its
    first step without a change.
    """
    sizes = np.arange(1, steps + 1)
    norm = float(np.linalg.norm(x0))
    stops, errors = [], []
    for key in keys:
        path = fuse_path(sample(x0, steps, rng=key), sizes, "slse", target=x0, estimates=True)
        assert path.estimates is not None  # estimates=True
        change = np.linalg.norm(np.diff(path.estimates, axis=0), axis=1)
        still = np.flatnonzero(change <= ROUNDING * norm)
        if still.size:
            stop = int(still[0]) + 1  # index of the size whose step changed nothing
            stops.append(int(sizes[stop]))
            errors.append(float(path.errors[stop]) / norm)
    return {
        "stopped": len(stops) / len(keys),
        "median_stop": float(np.median(stops)) if stops else None,
        "median_relative_error": float(np.median(errors)) if errors else None,
    }
