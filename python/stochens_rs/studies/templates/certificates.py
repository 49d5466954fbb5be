"""A study of certificates from data: how often they hold, and how tight they are."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..._base import validation
from ..._base.types import DELTA, Floats
from ...controls import Plan
from ...controls.control import control as controlled
from ...exceptions import DataWarning, InputError
from ...identification import Model, Trajectories
from ...identification.identifying import identify as identified
from ...rng import Key
from ...system import System
from ...theory.dynamics import checked_ends
from ..units import of_states
from .runs import RunDesign, Truth, checked_design
from .template import Template, compared, options, template


def coverage(
    system: Any,
    x0: ArrayLike,
    xf: ArrayLike,
    *,
    noise: ArrayLike | None = None,
    size: int | None = None,
    length: int = 10,
    starts: ArrayLike = 1.0,
    excitation: ArrayLike = 1.0,
    feedback: ArrayLike | None = None,
    runs: Trajectories | None = None,
    steps: int = 1,
    delta: float = DELTA,
    identify: Mapping[str, Any] | None = None,
    control: Mapping[str, Any] | None = None,
    bound: Mapping[str, Any] | None = None,
) -> Template:
    """Return the function of a study of how often certificates from runs hold, and how tight.

    Parameters
    ----------
    system : System, (A, B) or Model
        The truth. Of a `Model`: its estimate, offset and noise covariance, its runs as the design,
        and what it assumes as the default of `identify`.
    x0, xf : array_like, shape (n,)
        Initial state and target of the control.
    noise : float or array_like, shape (n,)
        Standard deviations of the Gaussian noise; may be left out for a `Model`.
    size : int, optional
        Number of runs; default: as many as in `runs`, or 30.
    length : int, default 10
        Steps of each run.
    starts, excitation : float or array_like, shapes (n,), (m,), default 1.0
        Standard deviations of x(0) and u(k) in the runs, Gaussian with mean 0.
    feedback : array_like, shape (m, n), optional
        Added to the inputs of the runs: ``feedback x(k)``.
    runs : Trajectories, optional
        Runs of one's own, whose x(0) and u(k) are repeated with new noise; with another `size`, in
        turn. They replace `length`, `starts` and `excitation`.
    steps : int, default 1
        Number of steps K of the control.
    delta : float, default 0.05
        Level of region and certificate.
    identify, control, bound : mapping, optional
        Arguments for `identify`, `control` and `Plan.bound`, such as ``{"sigma": 0.1}``. With
        ``{"design": "independent"}`` the last pair of each run is used.

    Returns
    -------
    Template
        ``function(key, size, steps, delta, noise)``, for a grid of any of these; noise: one
        standard deviation for all states. It returns "inside", whether the region contains the
        truth (0 or 1); "covered", whether the certificate is at least the true distance from xf
        after K steps; both numbers, "bound" and "error", and their "ratio".

    Raises
    ------
    InputError, InputTypeError
        If the arguments do not fit together, or Gaussian noise contradicts what is assumed.

    Examples
    --------
    >>> import stochens_rs as se
    >>> system = ([[0.9, 0.2], [-0.1, 0.8]], [[0.0], [1.0]])
    >>> function = se.studies.coverage(system, [1, 0], [0, 0], noise=0.1, steps=3)
    >>> results = se.Study(function, {"size": [10, 100]}, replicates=20, rng=1).run()
    >>> results.values["covered"].mean(axis=1)
    array([1., 1.])
    """
    c, told = None, options("identify", identify, identified, ("rng",))
    if isinstance(system, Model):
        if system.data.steps > 1:
            raise InputError("`system` must be a model of one step")
        told, runs = {**_declared(system), **told}, system.data if runs is None else runs
        known, c, covariance = system.system, system.c, system.covariance
        if noise is None and covariance is None:
            raise InputError("`noise` must be given: the model has too few pairs to estimate it")
    else:
        known, covariance = System.from_any(system), None
        if noise is None:
            raise InputError("`noise` must be given, unless `system` is a Model")
    if told.get("noise") == "bounded":
        raise InputError("`identify` must not have noise='bounded': Gaussian noise is drawn")
    if noise is None:
        values, vectors = np.linalg.eigh(covariance)  # type: ignore[arg-type]
        root: Floats = vectors * np.sqrt(np.maximum(values, 0.0))
    else:
        root = np.diag(validation.deviations("noise", noise, known.n))
    _, start, goal = checked_ends(known, x0, xf)
    return template(
        _numbers,
        ("size", "steps", "delta", "noise"),
        ("inside", "covered", "ratio", "size", "steps", "delta"),
        of_states(known.labels, "bound", "error", "noise"),
        truth=Truth(known, root, c),
        design=checked_design(known, runs, length, starts, excitation, feedback),
        x0=start,
        xf=goal,
        size=validation.size("size", (30 if runs is None else len(runs)) if size is None else size),
        steps=validation.size("steps", steps),
        delta=validation.probability("delta", delta),
        identify={"checks": False, **told},
        control=options("control", control, controlled, ("steps", "fusion")),
        bound=options("bound", bound, Plan.bound, ("system", "x0", "xf")),
    )


def _numbers(
    key: Key,
    *,
    truth: Truth,
    design: RunDesign,
    x0: Floats,
    xf: Floats,
    size: int,
    steps: int,
    delta: float,
    identify: dict[str, Any],
    control: dict[str, Any],
    bound: dict[str, Any],
    noise: float | None = None,
) -> dict[str, float]:
    sigma = None if noise is None else validation.nonnegative("noise", noise)
    data = design.draw(truth, validation.size("size", size), key.child("runs"), sigma)
    if identify.get("design") == "independent":
        data = data.last_pairs()
    with warnings.catch_warnings():  # the bound is infinite where the data leave things open
        warnings.simplefilter("ignore", DataWarning)
        model = identified(data, **identify)
    plan = controlled(model, x0, xf, steps=steps, **control)
    x, to_come = x0, truth.noise(key.child("noise to come"), len(plan.u), sigma=sigma)
    for u, w in zip(plan.u, to_come, strict=True):
        x = truth.step(x, u) + (w if bound.get("noise") else 0.0)
    inside = model.region(delta).contains(truth.system.A, truth.system.B, truth.c)
    found = compared(plan.bound(delta, **bound).target, float(np.linalg.norm(x - xf)))
    return {"inside": float(inside), **found}


def _declared(model: Model) -> dict[str, Any]:
    """What a model assumes, as arguments of `identify`."""
    noise, n, d = model.assumptions, model.n, model.n + model.m
    told: dict[str, Any] = {"design": noise.design, "noise": noise.noise}
    told["covariance"] = noise.covariance if noise.known is None else noise.known
    told["intercept"] = model.intercept
    told["scale"] = None if model.scale is None else model.scale[:d]
    if model.known is not None:
        told |= {"known_A": model.known[:, :n], "known_B": model.known[:, n:d]}
    return told
