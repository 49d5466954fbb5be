"""`identify`: from measured runs to a model, under assumptions that the user declares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .._base import validation
from .._base.names import Labels
from .._base.records import trusted
from .._base.types import ArrayLike, Floats
from ..data.trajectories import Trajectories, moved, pooled
from ..exceptions import InputError, ShapeError
from ..system.system import System
from . import assumptions
from . import checks as tests
from .assumptions import ANY, Misfit, Noise, Pilot, Window, sizes_of
from .identified import Identified
from .model import Model, Past, identified, require_fit
from .pilot import after, made, split
from .window import of_names, regressors_of, spread


def declared_past(runs: Trajectories, asked: Window) -> tuple[Past, bool]:
    """Lags, filters, or whether filters are tried; and whether z is more than the states now."""
    least, most = asked.delays
    if runs.outputs:
        lags = asked.lags if isinstance(asked.lags, int) else asked.lags is None
        return asked.filters or lags, True
    if asked.given:
        raise InputError(
            f"`{asked.given[0]}` is for outputs, but `data` has states: read it with outputs="
        )
    return 1 if least == most else False, most > 0


def identify(
    data: Trajectories | Sequence[Trajectories],
    *,
    noise: Noise | float | None = None,
    window: Window | None = None,
    pilot: Pilot | float | Identified | System | tuple[ArrayLike, ArrayLike] | None = None,
    intercept: bool = False,
    known: tuple[ArrayLike | None, ArrayLike | None] | None = None,
    scale: ArrayLike | None = None,
    misfit: Misfit | None = None,
    checks: bool = True,
    accept: str | Sequence[str] = (),
) -> Model:
    """Fit ``x(k+1) = A x(k) + B u(k) + c + w(k)`` to measured runs.

    States are measured without error, or are set points: your declaration. Errors of `x_next` alone
    count as noise. States that are read with error are passed as outputs, ``Trajectories(...,
    outputs=True)``: the model is then one of the readings, and their errors are part of its noise.

    Parameters
    ----------
    data : Trajectories or list of them
        The runs; several sets of one system are pooled.
    noise : Noise or float, optional
        The noise w(k), as you declare it; a number is its `sigma`. The default is Gaussian noise of
        one unknown covariance, in runs of any design.
    window : Window, optional
        For outputs, from which part of the past they are predicted; for states, their dead time.
    pilot : Pilot, optional
        Declares runs whose error has an exact law, whatever their length. A share, a number of
        runs, a model or a system is its `source`.
    intercept : bool, default False
        Whether there is an offset c. Do not centre the data by hand instead.
    known : (A, B), array_likes of shapes (n, n) and (n, m), optional
        Entries that are known beforehand; nan where an entry is to be estimated, None for a matrix
        of which none is known.
    scale : float or array_like, shape (n + m,), optional
        The size of states and inputs that is expected before the data, in their units. Regions for
        any design hold for any scale. Left out, it is that of the first eighth of the pairs, which
        are then not used otherwise for a region: the number of pairs must be fixed beforehand, and
        the runs be in the order of time. 1 for fewer than 4 pairs for each unknown of a row, and
        for regions that hold for all N at once.
    misfit : Misfit, optional
        What the plant has beside the linear model: it widens the region, and certificates of a
        feedback hold with it. Others are refused.
    checks : bool, default True
        Whether to test the residuals; not done for more than about 320 000 / n pairs, of which a
        warning says so: `Model.check` does it. `Model.doubts` are looked for in any case.
    accept : str or sequence of str, default ()
        Tests of the log, by the names in `Model.tests`, of which you take a failure: certificates
        are then made all the same, and say so. "no effect": gains for inputs of which no effect is
        seen.

    Returns
    -------
    Model
        Least squares; with `pilot` an estimate of its own, see there.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used, or contradicts another one.

    Warns
    -----
    DataWarning
        If columns are no states of a plant, see `Model.doubts`: then no certificate is finite. If
        the residuals speak against an assumption, with a probability of false alarm of 0.01; if
        they were not tested; if the data do not determine the model. No warning is no proof.

    Notes
    -----
    The pairs are reduced to one triangle by Householder's QR; normal equations are never formed.
    Data that do not determine the whole model are no error: the model is then the smallest one in
    the units of the data, and `Model.missing` names what is missing.

    Examples
    --------
    >>> import numpy as np, stochens_rs as se
    >>> rng = np.random.default_rng(1)
    >>> A, B = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[0.0], [1.0]])
    >>> states, inputs = [], []
    >>> for run in range(30):
    ...     u = rng.standard_normal((20, 1))
    ...     x = [np.zeros(2)]
    ...     for k in range(20):
    ...         x.append(A @ x[-1] + B @ u[k] + 0.01 * rng.standard_normal(2))
    ...     states.append(np.array(x))
    ...     inputs.append(u)
    >>> model = se.identify(se.Trajectories(states, inputs), noise=0.01)
    >>> model
    <Model: n=2 m=1, 600 pairs>
    >>> region = model.region(0.05)
    >>> region.contains(A, B), region.bound([1.0, 0.0], [0.0]) < 0.01
    (True, True)

    The inputs were fixed beforehand, and so is the task:

    >>> task = [1.0, 0.0], [0.0, 0.0], 5
    >>> data = se.Trajectories(states, inputs)
    >>> sharp = se.identify(data, noise=0.01, pilot=se.Pilot(0.1, reference=task))
    >>> plain, near = (se.control(one, *task[:2], steps=5).bound() for one in (model, sharp))
    >>> near.target < plain.target / 2
    True
    """
    runs, law = pooled(data), assumptions.as_noise(noise)
    asked = ANY if window is None else validation.instance("window", window, Window)
    guided = pilot if pilot is None or isinstance(pilot, Pilot) else Pilot(pilot)
    if asked.delay == -1:
        runs, asked = moved(runs), replace(asked, delay=0)
    if misfit is not None and validation.instance("misfit", misfit, Misfit).limit < np.inf:
        runs = below(runs, misfit)
    n, names = runs.n, runs.state_names
    assumed = assumptions.checked_assumptions(law, names, guided is not None, asked.tail, accept)
    offset = validation.flag("intercept", intercept)
    past, windowed = declared_past(runs, asked)
    past_pilot = guided is not None and guided.past
    for name, one in (("known", known), ("pilot", None if past_pilot else guided)):
        if windowed and one is not None:
            raise InputError(
                f"`{name}` must be left out for outputs, but for Pilot(inputs='any'): it is about "
                "states"
                if runs.outputs
                else f"`{name}` must be left out with `delay`: it is about states that say all"
            )
    entries = known_entries(n, runs.m, offset, known)
    sizes = None if scale is None else assumptions.checked_scale(scale, n + runs.m, offset)
    assumptions.refuse(assumed, n, runs.single)
    if misfit is not None:
        require_fit(misfit, runs, assumed, sizes, (windowed or None, guided, entries))
    guide = first = None
    if guided is not None and guided.past:
        lags = asked.lags if isinstance(asked.lags, int) else 1
        d = lags * (n + runs.m) + offset
        first, runs = split(runs, assumed, entries is not None, guided, d)
    elif guided is not None:
        guide, runs = made(runs, assumed, entries is not None, guided, offset)
    by = (tests.DRAWS, bytes(tests.KEY), tests.WORK) if validation.flag("checks", checks) else None
    about = assumed, sizes is not None, offset, entries, guided is not None
    found = identified(runs, past, *about, windowed, asked.delays, simulated=by)
    regressors = regressors_of(found, runs, offset) if windowed else None
    if regressors is not None:
        sizes = np.ones(regressors.length) if found.unit else spread(regressors, sizes)
    if first is not None and guided is not None:
        own = regressors or of_names(names, runs.input_names, offset)
        guide = after(first, runs, own, guided)
    residuals = tests.checks_of(found.checks, tests.DRAWS, assumed.design)
    fields = offset, entries, residuals, guide, regressors, found.first, misfit
    model = trusted(Model, runs, found.triangle, assumed, sizes, *fields)
    model._keep(core=found)
    tests.warn_of(model.warnings, "model.warnings")
    return model


def below(runs: Trajectories, misfit: Misfit) -> Trajectories:
    """The pairs that begin where the misfit is small enough, in their order."""
    x, u, x_next = runs.pairs()
    labels = Labels(runs.state_names, runs.input_names)
    kept = sizes_of(misfit, np.hstack([x, u]), labels) <= misfit.limit
    if not kept.any():
        raise InputError(f"`misfit` leaves out all pairs: none is below {misfit.limit:g}")
    how = {"state_names": labels.states, "input_names": labels.inputs}
    return Trajectories.from_pairs(x[kept], u[kept], x_next[kept], dt=runs.dt, **how)


def known_entries(n: int, m: int, offset: bool, given: Any) -> Floats | None:
    """The known entries of [A B c], nan where an entry is to be estimated; None if none is."""
    if given is None:
        return None
    known, pair = np.full((n, n + m + offset), np.nan), validation.items("known", given)
    if len(pair) != 2:
        raise ShapeError(f"`known` must be (A, B), each with nan or None, got {len(pair)} items")
    for k, (value, columns) in enumerate(zip(pair, (slice(n), slice(n, n + m)), strict=True)):
        if value is not None:
            name, wanted = f"known[{k}]", known[:, columns].shape
            entries = validation.array(name, value, ndim=(2,), finite=False)
            if entries.shape != wanted:
                raise ShapeError(f"`{name}` must have shape {wanted}, got {entries.shape}")
            known[:, columns] = entries
            assumptions.require_known(name, known)
    free = np.isnan(known)
    if not free.any():
        raise InputError("`known` must leave an entry to be estimated, got numbers alone")
    return None if free.all() else known
