"""Section 5.2 of the paper: a reference is tracked in a large random system (figure 3)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from stochens_rs import Key
from stochens_rs.cases import random_system
from stochens_rs.theory import moments

from .. import common as check
from ..common import FUSIONS, Floats, Fusion, PathLike, Progress, RngLike
from ..experiment import Experiment
from .recording import LARGEST, Orders, Quantity, Recording, both_orders
from .replicate import Sizes, Step, solves

# What figure 3(b) may show.
READINGS = {
    "rolled": "state x(2), rolled from the computed x(1)",
    "reference": "state x(2), from the reference x(1)",
}


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
    executor: Any = None,
    path: PathLike | None = None,
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
    progress : None, bool or callable, optional
        True: a bar on a terminal or in a notebook. A callable is called as
        ``progress(done, total)`` as replicates are done.
    executor, path : optional
        As in `power`.

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
    KeyboardInterrupt, StateError, StateIOError
        As in `power`.

    Notes
    -----
    With ``e(t) = B (u(t) - v(t))``, independent for t = 0 and 1 and of mean zero under uniform
    weights: ``x_comp(1) - x_actual(1) = e(0)``, ``x_comp(2) - x_actual(2) = A e(0) + e(1)``
    rolled and ``e(1)`` from the reference. Hence the exact mean squares ``tr C_0`` and ``tr(A C_0
    A^T) + tr C_1``, ``C_t = Cov e(t)``. Keys: "system", "x0", "x1", "x2"; below those of the
    replicates (see `power`) "step-t", below it "x0", "xf", "A".

    Examples
    --------
    >>> from paper import tracking
    >>> tracking(rng=1, replicates=2, samples=20, n=12, m=9).panel("3a").quantity
    'state x(1)'
    """
    record = Recording(rng, replicates, samples, sizes, tol)
    n, m = check.size("n", n), check.size("m", m)
    check.choice("step_two", step_two, tuple(READINGS))
    spectral_radius = check.positive("spectral_radius", spectral_radius, maximum=LARGEST)
    key = record.key
    system = random_system(n, m, rng=key.child("system"), spectral_radius=spectral_radius)
    A, B = system.A, system.B
    x = [key.child(f"x{t}").generator().standard_normal(n) for t in range(3)]
    one, two = steps = [Step(A, B, x[t], x[t + 1]) for t in range(2)]
    other = "reference" if step_two == "rolled" else "rolled"
    panel = {"x1": "3a", step_two: "3b", other: "3b-alternative"}
    record.run("tracking", TrackingErrors(one, two, record.tol), progress, executor, path)

    orders: dict[str, dict[Fusion, Orders]] = {"x1": {}, "rolled": {}, "reference": {}}
    for fusion in FUSIONS:
        first, second = (
            both_orders(partial(moments.state_covariance, system, s.x0, s.xf, fusion=fusion))
            for s in steps
        )
        orders["x1"][fusion], orders["reference"][fusion] = first, second
        orders["rolled"][fusion] = (
            A @ first[0] @ A.T + second[0],
            A @ first[1] @ A.T + second[1],
        )
    reached = {
        "x1": one.reached,
        "rolled": A @ one.reached + B @ two.control,
        "reference": two.reached,
    }
    names = {"x1": "state x(1)", **READINGS}
    symbol = r"$\|x_{\rm comp} - x_{\rm actual}\| \,/\, \|x_{\rm actual}\|$"
    panels = tuple(
        record.panel(
            Quantity(
                name,
                shown,
                None if shown == other else "3",
                names[shown],
                symbol,
                reached[shown],
                orders[shown],
                "all",
            )
        )
        for shown, name in panel.items()
    )
    ten_percent = 0.1 * float(np.linalg.norm(reached["x1"]))
    facts: dict[str, Any] = {
        "reachability": [step.unreachable() for step in steps],
        # Samples of each entity for a relative rms of 10 % in x(1) under uniform weights.
        "samples_for_ten_percent": {
            fusion: _required_size(both, ten_percent) for fusion, both in orders["x1"].items()
        },
    }
    settings = {"spectral_radius": float(spectral_radius), "step_two": step_two}
    title = "Tracking two reference states in a large random system"
    solved = {"x(t), x(t+1), A": "all"}
    return record.experiment("tracking", title, system, panels, solved, facts, settings)


@dataclass(frozen=True, eq=False)
class TrackingErrors:
    """The errors of one replicate of `tracking`, for a study with nested sizes."""

    one: Step
    two: Step
    tol: float

    def __call__(self, key: Key, size: Sizes) -> dict[str, Floats]:
        """The columns of the panels by what they show, and the solves."""
        steps = (self.one, self.two)
        drawn = [step.draw(key.child(f"step-{t}"), size, self.tol) for t, step in enumerate(steps)]
        # What each step adds to the state: e(t) = B (u(t) - v(t))
        first, second = (controls @ self.one.B.T for _, controls in drawn)
        states = {"x1": first, "rolled": first @ self.one.A.T + second, "reference": second}
        return {
            **{f"panel_{name}": np.linalg.norm(e, axis=2) for name, e in states.items()},
            **solves("all", (one for entities, _ in drawn for one in entities.values())),
        }


def _required_size(orders: Orders, level: float) -> int:
    """The smallest N with ``sqrt(tr C(N)) <= level``, for ``C(N) = C1 / N + C2 / N^2``."""
    a, b = (float(np.trace(C)) for C in orders)
    # level^2 N^2 - a N - b = 0
    return math.ceil((a + math.sqrt(a * a + 4 * level**2 * b)) / (2 * level**2))
