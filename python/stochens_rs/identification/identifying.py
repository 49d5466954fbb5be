"""`identify`: from measured runs to a model, under assumptions that the user declares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .. import _core
from .._base import validation
from .._base.names import Labels
from .._base.records import trusted
from .._base.running import get_num_threads
from .._base.types import ArrayLike, Floats
from ..data.trajectories import Trajectories, moved, pooled
from ..exceptions import InputError, NonFiniteError, ShapeError
from ..system.system import System
from . import assumptions
from .assumptions import ANY, Misfit, Noise, Pilot, Window, sizes_of
from .checks import KEY, too_many, warn_of
from .identified import Identified
from .model import Model, require_fit
from .pilot import made
from .window import Regressors, complete, of_names, rows_of, spread

POLES = (0.2, 0.4, 0.6, 0.8, 0.9)  # of filters that are tried
FILTERS, LAGS = 6, 12  # how many at most
COMPARED = 3  # of which two rows for each unknown are enough for a choice
SHARE = 4  # the first quarter of the pairs chooses
FILLED = 4  # filters that use up more than a quarter of the median piece give way to lags


def chosen_window(runs: Trajectories, asked: Window, offset: bool) -> tuple[Regressors | None, int]:
    """The regressors of a window, and how many pairs they were chosen from.

    None and 0 for states without a dead time; with one, the states now and past inputs.
    """
    lags, filters, given = asked.lags, asked.filters, asked.given
    least, most = asked.delay if isinstance(asked.delay, tuple) else (asked.delay, asked.delay)
    if not runs.outputs:
        if given:
            raise InputError(
                f"`{given[0]}` is for outputs, but `data` has states: read it with outputs="
            )
        if most == 0:
            return None, 0
        if least == most:
            lags = 1
    # for filters that are declared the first part says only how long they fill
    first = -(-runs.size // (SHARE if filters is None else 2 * SHARE))
    names = runs.state_names, runs.input_names
    auto = lags == "auto"
    if isinstance(lags, int):
        return trusted(Regressors, *names, lags, None, least, offset), 0
    begins = (runs.layout.places()[:first] == 0).tolist()
    start = runs.rows[:first], begins, runs.n, runs.m, offset
    if filters is not None:
        pole, count = filters
        ratio = _core.readings_over_noise(*start)
        burn = _core.window_burn(pole, count, ratio, len(runs.pieces))
        return trusted(Regressors, *names, count, pole, least, offset, burn), first
    poles = [] if auto or not runs.outputs else list(POLES)
    tried = (FILTERS, LAGS if runs.outputs else 1)
    pieces = len(runs.pieces), int(np.median(runs.pieces))
    found = _core.choose_window(*start, poles, tried, (least, most), pieces)
    if not runs.outputs:  # states say all of the past but the inputs under way
        return trusted(Regressors, *names, 1, None, found[2], offset), first
    if FILLED * found[3] > pieces[1]:
        found = _core.choose_window(*start, [], tried, (least, most), pieces)
    own_pole, count, back, burn, least, rows = found
    # two rows for each unknown of a longer window, or nothing says that a short one is enough
    needed = 2 * (min(least + 1, COMPARED) * (runs.n + runs.m) + offset + runs.n)
    if rows < needed:
        raise InputError(
            f"`data` must be longer, or Window(lags=) declared, got {runs.size} pairs, and needs "
            f"{SHARE * (first + needed - rows)} to choose one"
        )
    window = trusted(Regressors, *names, count, own_pole, back, offset, burn, least)
    return window, first


def sized(
    runs: Trajectories, window: Regressors, sizes: Floats | None, first: int
) -> tuple[Floats | None, int]:
    """The expected sizes of z, None for those of the first part, and how many pairs that has.

    The first part holds the pairs that the window was chosen from, and the first rows that say the
    size of the others; where all rows are too few for that, z is expected to be of size 1.
    """
    if sizes is not None:
        return spread(window, sizes), first
    rows, at = complete(window, runs)
    asked = _core.first_pairs(rows, window.length, get_num_threads())
    if asked is None:
        return np.ones(window.length), first
    return None, first if asked <= np.searchsorted(at, first) else int(at[asked])


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
    past, first = chosen_window(runs, asked, offset)
    for name, one in (("known", known), ("pilot", guided)):
        if past is not None and one is not None:
            raise InputError(
                f"`{name}` must be left out for outputs: it is about states"
                if runs.outputs
                else f"`{name}` must be left out with `delay`: it is about states that say all"
            )
    regressors = past or of_names(names, runs.input_names, offset)
    entries = known_entries(n, runs.m, offset, known)
    sizes = None if scale is None else assumptions.checked_scale(scale, n + runs.m, offset)
    if past is not None:
        sizes, first = sized(runs, past, sizes, first)
    assumptions.refuse(assumed, n, runs.single)
    if misfit is not None:
        require_fit(misfit, runs, assumed, sizes, (past, guided, entries))
    guide = None
    if guided is not None:
        guide, runs = made(runs, assumed, entries is not None, guided, offset)
    rows = rows_of(regressors, runs, first)[1]
    with np.errstate(over="ignore"):
        if not np.isfinite(np.vdot(rows, rows)):
            raise NonFiniteError("the squares of the data overflow: scale the data down")
    wanted = validation.flag("checks", checks) and not too_many(len(rows), n)
    triangle = _core.triangle(rows, get_num_threads())
    if not np.isfinite(triangle).all():
        raise NonFiniteError("the products of the data overflow: scale them down")
    found = runs, triangle, assumed, sizes, offset, entries, None, guide, past, first, misfit
    model = trusted(Model, *found)
    if wanted:
        model._keep(checks=model.check(rng=KEY))
    warn_of(model.warnings, "model.warnings")
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
    known = np.full((n, n + m + offset), np.nan)
    pair = (None, None) if given is None else validation.items("known", given)
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
