"""`identify`: from measured runs to a model, under assumptions that the user declares."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from .. import _core
from .._base import running, show, validation
from .._base.running import get_num_threads
from ..data.trajectories import Trajectories, pooled
from ..exceptions import DataWarning, InputError, InputTypeError, NonFiniteError, ShapeError
from .assumptions import (
    LARGEST,
    Covariance,
    Design,
    Noise,
    checked_assumptions,
    checked_scale,
    refuse,
)
from .checks import DRAWS, WORK, checked_residuals, tested_rows
from .model import Model
from .pilot import made
from .window import Window

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .._base.types import Floats
    from ..system.system import System
    from .identified import Identified


Lags: TypeAlias = "int | Literal['auto'] | None"
Order: TypeAlias = "Literal['auto'] | None"
Delay: TypeAlias = "int | tuple[int, int]"

POLES = (0.2, 0.4, 0.6, 0.8, 0.9)  # of filters that are tried
FILTERS, LAGS = 6, 12  # how many at most
COMPARED = 3  # of which two rows for each unknown are enough for a choice
LONGEST = 2**16  # of lags, filters and delays
SHARE = 4  # the first quarter of the pairs chooses
FILLED = 4  # filters that use up more than a quarter of the median piece give way to lags


def chosen_window(
    runs: Trajectories, lags: Any, filters: Any, order: Any, delay: Any, offset: bool
) -> tuple[Window | None, int]:
    """The window of the arguments of `identify`, and how many pairs it was chosen from.

    None and 0 for states without a dead time; with one, a window of the states now and past inputs.
    """
    asked = {"lags": lags, "filters": filters, "order": order}
    given = [name for name, one in asked.items() if one is not None]
    least, most = _delays(delay)
    if not runs.outputs:
        if given:
            raise InputError(
                f"`{given[0]}` is for outputs, but `data` has states: read it with outputs= in "
                "place of states="
            )
        if most == 0:
            return None, 0
        if runs.steps > 1:
            raise InputError("`delay` must be left out for pairs over several steps")
        if least == most:
            lags = 1
    if len(given) > 1:
        raise InputError(f"only one of `lags`, `filters` and `order` must be given, got {given}")
    # for filters that are declared the first part says only how long they fill
    first = -(-runs.size // (SHARE if filters is None else 2 * SHARE))
    names = runs.state_names, runs.input_names
    auto = isinstance(lags, str) and lags == "auto"
    if lags is not None and not auto:
        if least != most:
            raise InputError("`delay` must be one number with `lags`: a range is for order='auto'")
        return Window(
            *names, validation.size("lags", lags, maximum=LONGEST), None, least, offset
        ), 0
    begins = (runs._pieces.places()[:first] == 0).tolist()
    start = runs._rows[:first], begins, runs.n, runs.m, offset
    if filters is not None:
        pole, count = _filters(filters)
        if least != most:
            raise InputError("`delay` must be one number with `filters`")
        ratio = _core.readings_over_noise(*start)
        burn = _core.window_burn(pole, count, ratio, len(runs.pieces))
        return Window(*names, count, pole, least, offset, burn), first
    poles = [] if auto or not runs.outputs else list(POLES)
    tried = (FILTERS, LAGS if runs.outputs else 1)
    if order is not None:
        validation.choice("order", order, ("auto",))
    pieces = len(runs.pieces), int(np.median(runs.pieces))
    found = _core.choose_window(*start, poles, tried, (least, most), pieces)
    if not runs.outputs:  # states say all of the past but the inputs under way
        return Window(*names, 1, None, found[2], offset), first
    if FILLED * found[3] > pieces[1]:
        found = _core.choose_window(*start, [], tried, (least, most), pieces)
    one, count, back, burn, told, rows = found
    # two rows for each unknown of a longer window, or nothing says that a short one is enough
    needed = 2 * (min(told + 1, COMPARED) * (runs.n + runs.m) + offset + runs.n)
    if rows < needed:
        raise InputError(
            f"`data` must be longer, or its window declared by lags= or filters=, got {runs.size} "
            f"pairs, and needs {SHARE * (first + needed - rows)} to choose one by its first quarter"
        )
    return Window(*names, count, one, back, offset, burn, told), first


def sized(
    runs: Trajectories, window: Window, sizes: Floats | None, first: int
) -> tuple[Floats | None, int]:
    """The expected sizes of z, None for those of the first part, and how many pairs that has.

    The first part holds the pairs that the window was chosen from, and the first rows that say the
    size of the others; where all rows are too few for that, z is expected to be of size 1.
    """
    if sizes is not None:
        return window._spread(sizes), first
    before, after = window._rows(runs, first)
    rows = np.concatenate([before, after])
    asked = _core.first_pairs(rows, window.length, get_num_threads())
    if asked is None:
        return np.ones(window.length), first
    count = max(asked, len(before))
    return None, first if count == len(before) else window._place(runs, count)


def _delays(delay: Any) -> tuple[int, int]:
    """The least and the largest delay."""
    if isinstance(delay, tuple):
        if len(delay) != 2:
            raise InputError(
                f"`delay` must be a number or a pair of them, got {validation.show(delay)}"
            )
        least = validation.size("delay[0]", delay[0], minimum=0)
        return least, validation.size("delay[1]", delay[1], minimum=least, maximum=LONGEST)
    one = validation.size("delay", delay, minimum=0, maximum=LONGEST)
    return one, one


def _filters(filters: Any) -> tuple[float, int]:
    if not isinstance(filters, (tuple, list)) or len(filters) != 2:
        raise InputError(
            f"`filters` must be a pair (pole, number), as (0.8, 4), got {validation.show(filters)}"
        )
    pole = validation.probability("filters[0]", filters[0])
    return pole, validation.size("filters[1]", filters[1], maximum=LONGEST)


def identify(
    data: Trajectories | Sequence[Trajectories],
    *,
    design: Design = "adaptive",
    noise: Noise = "gaussian",
    covariance: Covariance | ArrayLike = "full",
    sigma: float | None = None,
    intercept: bool = False,
    known_A: ArrayLike | None = None,
    known_B: ArrayLike | None = None,
    exact: Sequence[str | int] = (),
    scale: ArrayLike | None = None,
    pilot: float | Identified | System | tuple[ArrayLike, ArrayLike] | None = None,
    reference: Any = None,
    inputs: Literal["open loop"] | ArrayLike = "open loop",
    dither: ArrayLike | None = None,
    lengths_fixed: bool = False,
    lags: Lags = None,
    filters: tuple[float, int] | None = None,
    order: Order = None,
    delay: Delay = 0,
    tail: float = 0.0,
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
    design : {"adaptive", "independent"}, default "adaptive"
        "adaptive": inputs and states may depend on earlier noise, as in every run of more than one
        step. "independent": your declaration that all states and inputs of the pairs are
        independent of all noise in `x_next`; for pairs only (`Trajectories.from_pairs`,
        `last_pairs`, `k_step`). Never inferred.
    noise : {"gaussian", "sub-gaussian", "bounded"}, default "gaussian"
        The law of w(k), of mean 0. "sub-gaussian": ``E exp(l' w) <= exp(sigma^2 ||l||^2 / 2)``
        given the past. "bounded": ``||w||_2 <= sigma``.
    covariance : {"full", "diagonal", "scalar"} or array_like of shape (n, n), default "full"
        Of Gaussian noise: one unknown matrix, an unknown diagonal one, an unknown multiple of I, or
        the matrix itself, which may be singular with a `pilot`. For "sub-gaussian" noise a matrix
        in place of ``sigma^2 I``.
    sigma : float, optional
        The known size of the noise, see `noise`: for Gaussian noise the covariance is
        ``sigma^2 I``.
    intercept : bool, default False
        Whether there is an offset c. Do not centre the data by hand instead.
    known_A, known_B : array_like, shapes (n, n), (n, m), optional
        Entries that are known beforehand; nan where an entry is to be estimated.
    exact : sequence of str or int, default ()
        States, by name or number, without noise of their own: your declaration that it is 0, or a
        combination of that of the other states, as where one force disturbs position and velocity,
        or for the states of a Kalman filter in its steady state. Not for columns that were computed
        from others, as velocities by finite differences: they are no states. Rows of which the
        whole state matrix is in `known_A` count as declared.
    scale : float or array_like, shape (n + m,), optional
        The size of states and inputs that is expected before the data, in their units. Regions for
        ``design="adaptive"`` hold for any scale. Left out, it is that of the first eighth of the
        pairs, which are then not used otherwise for a region: the number of pairs must be fixed
        beforehand, and the runs be in the order of time. 1 for fewer than 4 pairs for each unknown
        of a row, and for regions that hold for all N at once.
    pilot : float, int, model or system, optional
        Declares runs whose error has an exact law, whatever their length: Gaussian noise; number
        and lengths of runs fixed beforehand; starts measured without error and independent of the
        noise of all runs; `inputs` as declared. The pilot repeats the runs on paper, and the model
        is estimated with what it predicts as instruments. A share (0.1) or number of the first
        runs, which are then not used otherwise, at least two, two pairs for each unknown, and five
        where 3/10 of the runs have so many; or a model or system from elsewhere, as of an older
        plant: right or wrong, but not of these runs.
    reference : (x0, xf, steps) or Plan, optional
        With `pilot`, the task that plans will be about, fixed without the runs of the model: never
        a state that they led to. `Plan.bound` of a plan of as many steps is then close to the error
        itself where the plan is near the pilot's; starts and targets are free.
    inputs : "open loop" or array_like of shape (m, n), default "open loop"
        With `pilot`, how the inputs of the runs were made: independent of the noise, or ``gain x +
        dither`` with this gain.
    dither : array_like, shape (N, m), optional
        What was added to the feedback, as it was recorded, not computed from u and x.
    lengths_fixed : bool, default False
        With `pilot`, your declaration that runs of unequal length are so by plan: their lengths
        were fixed beforehand, and no run was ended because of what was measured.
    lags, filters, order : int or "auto", (pole, int), "auto", optional
        For outputs, one of them: from which window of the past they are predicted. The last `lags`
        readings and inputs; or so many filters in a row of one pole in (0, 1), which reach further
        back with fewer unknowns; or what the first quarter of the pairs asks for by Akaike's
        criterion, and half as much again: the default. That quarter then counts no more.
    delay : int or (int, int), default 0
        The dead time: after how many steps an input acts. A pair is a range, of which the first
        quarter of the pairs chooses. Of states, the model is then one of a `window`: of the states
        now and the inputs under way, ``x(k+1) = A x(k) + B u(k - delay) + c + w(k)``; what takes a
        `record` takes states and inputs measured. -1: a row of the data holds the states *after*
        its input, so that the inputs are moved by one row.
    tail : float, default 0.0
        What the model leaves out of the outcomes beside their noise, as the part of readings that
        reaches further back than the window: at most this in root mean square over the pairs, in
        deviations of the noise. Nothing in the data bounds it: 0 is your declaration that the
        window is long enough.
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
    >>> model = se.identify(se.Trajectories(states, inputs), sigma=0.01)
    >>> model
    <Model: n=2 m=1, 600 pairs>
    >>> region = model.region(0.05)
    >>> region.contains(A, B), region.bound([1.0, 0.0], [0.0]) < 0.01
    (True, True)

    The inputs were fixed beforehand, and so is the task:

    >>> task = [1.0, 0.0], [0.0, 0.0], 5
    >>> data = se.Trajectories(states, inputs)
    >>> sharp = se.identify(data, sigma=0.01, pilot=0.1, reference=task)
    >>> plain, near = (se.control(one, *task[:2], steps=5).bound() for one in (model, sharp))
    >>> near.target < plain.target / 2
    True
    """
    runs = pooled(data)
    if validation.is_real(delay) and delay == -1:
        runs, delay = runs._moved(), 0
    n, piloted = runs.n, pilot is not None
    assumed = checked_assumptions(
        *(n, design, noise, covariance, sigma, exact, runs.state_names),
        piloted,
        validation.nonnegative("tail", tail),
        accept,
    )
    planned = validation.flag("lengths_fixed", lengths_fixed)
    offset = validation.flag("intercept", intercept)
    window, first = chosen_window(runs, lags, filters, order, delay, offset)
    if window is not None:
        _refuse_for_windows(bool(runs.outputs), known_A, known_B, pilot)
    d = n + runs.m + offset if window is None else window.length
    known = _known(n, runs.m, offset, known_A, known_B)
    sizes = None if scale is None else checked_scale(scale, n + runs.m, offset)
    if window is not None:
        sizes, first = sized(runs, window, sizes, first)
    refuse(assumed, runs.single)
    guide = None
    if piloted:
        given = pilot, offset, reference, inputs, dither, planned
        guide, runs = made(runs, assumed, known is not None, *given)
    elif planned or not (reference is None and dither is None and _unsaid(inputs)):
        raise InputError(
            "`reference`, `inputs`, `dither` and `lengths_fixed` must be left out without `pilot`"
        )
    Z = _rows(runs, offset) if window is None else window._rows(runs, first)[1]
    with np.errstate(over="ignore"):
        if not np.isfinite(np.vdot(Z, Z)):
            raise NonFiniteError("the squares of the data overflow: scale the data down")
    tested = None
    if validation.flag("checks", checks) and len(Z) * n * DRAWS <= WORK:
        own, outcomes = np.ascontiguousarray(Z[:, :d]), np.ascontiguousarray(Z[:, d:])
        rows = tested_rows(assumed, known, n)
        tested = checked_residuals(own, outcomes, rows, exact=assumed.design == "independent")
    triangle = _core.triangle(Z, get_num_threads())
    if not np.isfinite(triangle).all():
        raise NonFiniteError("the products of the data overflow: scale them down")
    found = runs, triangle, assumed, sizes, offset, known, tested, guide, window, first
    model = Model(*found)
    if model.warnings:
        said, more = model.warnings[0], len(model.warnings) - 1
        said += f"; {show.number_of(more, 'more warning')}: see model.warnings" if more else ""
        warnings.warn(DataWarning(said), stacklevel=2)
    return model


def _refuse_for_windows(outputs: bool, *given: Any) -> None:
    """Refuse what is for states whose inputs act at once."""
    names = "known_A", "known_B", "pilot"
    for name, one in zip(names, given, strict=True):
        if one is not None and outputs:
            raise InputError(
                f"`{name}` must be left out for outputs: it is about states, and errors of reading "
                "are part of the noise of a model of outputs"
            )
        if one is not None:
            raise InputError(
                f"`{name}` must be left out with `delay`: it is about states that say all of the "
                "past, and with a dead time inputs are under way"
            )


def _unsaid(inputs: object) -> bool:
    """Whether `inputs` has its default."""
    return isinstance(inputs, str) and inputs == "open loop"


def _rows(runs: Trajectories, offset: bool) -> Floats:
    """The rows (x, u, 1, x_next) of all pairs."""
    if not offset:
        return runs._rows
    x, u, y = runs.pairs()
    running.need("the pairs", runs._rows.nbytes + 8 * len(x))
    return np.hstack([x, u, np.ones((len(x), 1)), y])


def _known(n: int, m: int, offset: bool, A: ArrayLike | None, B: ArrayLike | None) -> Floats | None:
    """The known entries of [A B c], nan where an entry is to be estimated; None if none is."""
    if A is None and B is None:
        return None
    known = np.full((n, n + m + offset), np.nan)
    for name, value, start, width in (("known_A", A, 0, n), ("known_B", B, n, m)):
        if value is None:
            continue
        given = validation.read(name, value)
        if given.dtype.kind not in "iuf":
            raise InputTypeError(
                f"`{name}` must contain real numbers, got {validation.show(value)}"
            )
        if given.shape != (n, width):
            raise ShapeError(f"`{name}` must have shape ({n}, {width}), got {given.shape}")
        floats = given.astype(np.float64)
        if (np.abs(floats) > LARGEST).any():
            raise InputError(
                f"`{name}` must contain numbers up to {LARGEST:g}, or nan for what is to estimate"
            )
        known[:, start : start + width] = floats
    if not np.isnan(known).any():
        raise InputError("`known_A` and `known_B` leave nothing to estimate")
    return known if not np.isnan(known).all() else None
