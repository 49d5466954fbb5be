"""Section 5.1 of the paper: a power network, one step towards the origin (figures 1 and 2)."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from stochens_rs import Ensemble, Key, System, fuse_path
from stochens_rs.cases import CASES
from stochens_rs.exceptions import InputError
from stochens_rs.theory import moments

from .. import common as check
from ..common import FUSIONS, ROUNDING, Floats, PathLike, Progress, RngLike
from ..curves import Panel
from ..experiment import Experiment
from .recording import LARGEST, Quantity, Recording, both_orders
from .replicate import Sizes, Step, solves

_RULE_STEPS = 200  # samples of x0 to which the printed stopping rule is applied, at most


def power(
    given: Any = None,
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
    executor: Any = None,
    path: PathLike | None = None,
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
    given : System, optional
        A system of your own in place of the case, or anything `System.from_any` takes. All of its
        states have the deviation `angle_std` in x0.
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
        ``progress(done, total)`` as replicates are done.
    executor, path : optional
        As in :meth:`stochens_rs.Study.run`: where the replicates run, and the file in which their
        errors are kept as they are found. The results are the same bits with any executor, and
        after any interruption.

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
    KeyboardInterrupt
        After Ctrl-C or SIGTERM, when what is done is in `path`: the same call continues.
    StateError, StateIOError
        The file is of another run, damaged, in use, or cannot be written.

    Notes
    -----
    The exact values for uniform weights are the second moments of
    :mod:`stochens_rs.theory.moments`; the paper has none. Keys: "x0" for the initial state;
    those of a `Study` without axes in its key for the replicates, and below them "x0", "xf", "A"
    for the samples.

    Examples
    --------
    >>> from paper import power
    >>> result = power(rng=1, replicates=2, samples=50)
    >>> [panel.name for panel in result.panels]
    ['1a', '1b', '2a', '2b']
    """
    record = Recording(rng, replicates, samples, sizes, tol)
    angle_std = check.positive("angle_std", angle_std, maximum=LARGEST)
    speed_std = check.positive("speed_std", speed_std, maximum=LARGEST)
    options = {"data": data, "base": base, "dt": dt, "method": method}
    system = _system(case, options) if given is None else System.from_any(given)
    A, B, n = system.A, system.B, system.n
    own = given is not None
    scale = np.full(n, angle_std) if own else np.repeat([angle_std, speed_std], n // 2)
    x0, xf = record.key.child("x0").generator().standard_normal(n) * scale, np.zeros(n)
    step = Step(A, B, x0, xf)
    record.run("power network", PowerErrors(step, record.tol), progress, executor, path)

    def columns(N: int) -> Floats:  # independent: one block each
        return np.array([moments.covariance(column, N) for column in A.T])

    def fused(covariance: Any) -> dict[Any, Any]:
        return {f: both_orders(partial(covariance, system, x0, xf, fusion=f)) for f in FUSIONS}

    v, reached = step.control, step.reached
    vector = {None: both_orders(partial(moments.covariance, x0))}
    matrix = {None: both_orders(columns)}
    control, state = fused(moments.control_covariance), fused(moments.state_covariance)
    panels = tuple(
        record.panel(Quantity(name, name, name[0], *shown))
        for name, *shown in (
            ("1a", "initial state", r"$\|\hat x_0 - x_0\| \,/\, \|x_0\|$", x0, vector, None),
            ("1b", "system matrix", r"$\|\hat A - A\|_F \,/\, \|A\|_F$", A, matrix, "A"),
            ("2a", "control", r"$\|u - v^*\| \,/\, \|v^*\|$", v, control, "A"),
            (
                "2b",
                "state after one step",
                r"$\|B(u - v^*)\| \,/\, \|x_{\rm actual}\|$",
                reached,
                state,
                "A",
            ),
        )
    )
    estimates = panels[:2]
    facts: dict[str, Any] = {
        "reachability": {**step.unreachable(), "rank": int(np.linalg.matrix_rank(B))},
        "slse_mean_square_over_bound": {
            p.name: _slse_over_bound(p, record.sizes) for p in estimates
        },
        "zero_from": {p.name: _zero_from(p, record.sizes) for p in estimates},
        "smallest_slse_error": {
            p.name: float(p.curve("slse").errors[:, -1].min()) for p in estimates
        },
        "stopping_rule": _stopping_rule(*(record.values[k][0] for k in ("stop", "stop_error"))),
    }
    settings: dict[str, Any] = {"x0": x0.tolist(), "x0_std": angle_std}
    if not own:
        stds = {"angle_std": angle_std, "speed_std": speed_std}
        settings = {"case": case, **options, "dt": float(dt), **stds, "x0": x0.tolist()}
    title = f"{'One step' if own else 'Power network, one step'} to the origin"
    solved = {"x0": "x0", "A": "A"}
    return record.experiment("power", title, system, panels, solved, facts, settings)


@dataclass(frozen=True, eq=False)
class PowerErrors:
    """The errors of one replicate of `power`, for a study with nested sizes."""

    step: Step
    tol: float

    def __call__(self, key: Key, size: Sizes) -> dict[str, Floats]:
        """The columns of the panels, the solves, and where the printed rule stops."""
        drawn, controls = self.step.draw(key, size, self.tol)
        x0, A = drawn["x0"], drawn["A"]
        stop = _printed_stop(x0.ensemble, self.step.x0)
        return {
            "panel_1a": x0.errors,
            "panel_1b": A.errors,
            "panel_2a": np.linalg.norm(controls, axis=2),
            "panel_2b": np.linalg.norm(controls @ self.step.B.T, axis=2),
            **solves("x0", [x0]),
            **solves("A", [A]),
            # the same for all sizes
            "stop": np.full(len(size), stop[0]),
            "stop_error": np.full(len(size), stop[1]),
        }


def _system(case: str, options: dict[str, Any]) -> System:
    """The chosen network; an option that it does not have must be left at its default."""
    made = CASES[check.choice("case", case, tuple(CASES))]
    known, defaults = (inspect.signature(one).parameters for one in (made, power))
    for name, value in options.items():
        if name not in known and value != defaults[name].default:
            raise InputError(
                f"`{name}` must be left out with case {case!r}, which has no such option, "
                f"got {value!r}"
            )
    return made(**{name: value for name, value in options.items() if name in known})


def _zero_from(panel: Panel, sizes: Sizes) -> int | None:
    """The smallest size from which on all errors of ALSE are zero (to the panel's level)."""
    zero = np.all(panel.curve("alse").errors <= panel.zero_level, axis=0)
    steady = np.logical_and.accumulate(zero[::-1])[::-1]
    return int(sizes[np.argmax(steady)]) if steady.any() else None


def _slse_over_bound(panel: Panel, sizes: Sizes) -> float:
    """Largest ratio, over the sizes from 2 on, of SLSE's mean square to the exact one of uniform
    weights.

    At most 1 in expectation (Lemma 4.5, corrected: ``E d_n^2 <= V / n``); at n = 1 both are the
    same sample.
    """
    exact = panel.curve("uniform").exact_rms
    assert exact is not None  # uniform weights have one
    later = sizes >= min(2, sizes[-1])
    return float(np.max((panel.curve("slse").rms[later] / exact[later]) ** 2))


def _printed_stop(ensemble: Ensemble, x0: Floats) -> tuple[float, float]:
    """Where Algorithm 1's printed test would stop while it refines x0, and the relative error then.

    The printed ``error = ||(w1 - 1) v + w2 v'||`` is the length of the last change. A sample that
    does not help gets weight 0, the change is 0, and the loop ends for every positive error
    bound. The SLSE estimate of x0 is followed, for at most `_RULE_STEPS` samples, until its first
    step without a change; nan if there is none.
    """
    sizes = np.arange(1, min(_RULE_STEPS, ensemble.size) + 1)
    norm = float(np.linalg.norm(x0))
    path = fuse_path(ensemble, sizes, "slse", target=x0, estimates=True)
    assert path.estimates is not None  # estimates=True
    change = np.linalg.norm(np.diff(path.estimates, axis=0), axis=1)
    still = np.flatnonzero(change <= ROUNDING * norm)
    if not still.size:
        return np.nan, np.nan
    stop = int(still[0]) + 1  # index of the size whose step changed nothing
    return float(sizes[stop]), float(path.errors[stop]) / norm


def _stopping_rule(stops: Floats, errors: Floats) -> dict[str, Any]:
    """How often, where and how far away the printed rule stops."""
    found = ~np.isnan(stops)
    return {
        "stopped": float(np.mean(found)),
        "median_stop": float(np.median(stops[found])) if found.any() else None,
        "median_relative_error": float(np.median(errors[found])) if found.any() else None,
    }
