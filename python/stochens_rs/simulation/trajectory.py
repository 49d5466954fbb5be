"""Trajectories, and simulation of ``x(k+1) = A x(k) + B u(k)``, exact and at random.

``times[k]`` is ``k dt`` where the system states a step length, otherwise the step number k.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated, Any, ClassVar, TypeAlias

import numpy as np

from .. import _core
from .._base import running, show, validation
from .._base.names import Labels, default_labels, two_states
from .._base.records import Count, Positive, SavedRecord
from .._base.tables import Timed
from .._base.types import AVERAGINGS, ArrayLike, Averaging, Axes, Centre, Floats
from ..ensembles.systems import SystemEnsemble
from ..exceptions import InputError, NonFiniteError, ShapeError
from ..plots.lines import draw_phase, draw_states
from ..rng import Key, RngLike, as_key
from ..system.system import System
from ..theory.exact import checked_motion


class _OverTime(SavedRecord, Timed, listed=False):
    """What both trajectories have: a phase portrait, and names of the states that are drawn."""

    _drawn: ClassVar[str]  # the field with the curves, the states or their means, (K + 1, n)

    @property
    def steps(self: Any) -> int:
        """The number of steps K."""
        return len(self.inputs)

    def plot_phase(self, across: str | int, up: str | int, *, ax: Axes | None = None) -> Axes:
        """Draw two states, or their means, against each other.

        A ring is at the start, a dot at the end.

        Parameters
        ----------
        across, up : str or int
            The two states, by name or number.
        ax : matplotlib Axes, optional
            Where to draw, as for `plot`.

        Returns
        -------
        matplotlib Axes

        Raises
        ------
        ImportError
            matplotlib is not installed.
        InputError, InputTypeError
            There is no such state.

        Examples
        --------
        >>> import stochens_rs as se
        >>> path = se.simulate(([[1.0, 0.1], [-0.1, 1.0]], [[0.0], [0.1]]), [1.0, 0.0], [[0.0]] * 9)
        >>> path.plot_phase(0, 1).get_xlabel()
        'x[0]'
        """
        labels = self._labels
        at = two_states(labels, across, up)
        names = labels.state_axes
        curves = getattr(self, self._drawn)[:, at]
        return draw_phase([(curves, None)], (names[at[0]], names[at[1]]), ax=ax)

    @property
    def _labels(self: Any) -> Labels:
        return self.labels or default_labels(
            getattr(self, self._drawn).shape[1], self.inputs.shape[1]
        )

    def _shown(self: Any, states: object) -> tuple[list[int], dict[str, Any]]:
        """The places of the chosen states, and how they are named."""
        labels = self._labels
        at = labels.places("states", states)
        known = dict(labels.units)
        unit, *others = {known.get(labels.states[i]) for i in at}
        alike = unit is not None and not others  # then the axis names it
        named = labels.states if alike else labels.state_axes
        up = f"state [{unit}]" if alike else "state"
        return at, {"names": [named[i] for i in at], "up": up, "timed": self.dt is not None}


class Trajectory(_OverTime):
    """The trajectory of an exact system under given inputs.

    Attributes
    ----------
    states : ndarray, shape (K + 1, n)
        ``states[k]`` is ``x(k)``; the first is the initial state.
    inputs : ndarray, shape (K, m)
        ``inputs[k]`` is ``u(k)``, which leads from ``x(k)`` to ``x(k + 1)``.
    times : ndarray, shape (K + 1,)
        ``k dt`` [s], or k if the system states no step length.
    dt : float or None
        The step length [s]; None if the system states none.
    labels : Labels or None
        Names and units of the states and inputs, as those of the system.
    """

    _drawn = "states"

    states: Annotated[Floats, "step+1 state"]
    inputs: Annotated[Floats, "step input"]
    times: Annotated[Floats, "step+1"]
    dt: Positive | None = None
    labels: Labels | None = None

    def plot(
        self, states: str | int | Sequence[str | int] | None = None, *, ax: Axes | None = None
    ) -> Axes:
        """Draw every state over time.

        Parameters
        ----------
        states : str, int or list of them, optional
            Which states, by name or number. Default: all.
        ax : matplotlib Axes, optional
            Where to draw. Default: new axes on a figure of their own, which a notebook shows. In a
            script ``path.plot().figure.savefig("path.png")`` saves it; for a window, pass
            ``ax=plt.subplots()[1]`` and call ``plt.show()``.

        Returns
        -------
        matplotlib Axes

        Raises
        ------
        ImportError
            matplotlib is not installed.
        InputError, InputTypeError
            There is no such state.

        Examples
        --------
        >>> import stochens_rs as se
        >>> path = se.simulate(([[0.5]], [[1.0]]), [0.0], [[1.0], [0.0]])
        >>> path.plot().get_ylabel()
        'state'
        """
        at, how = self._shown(states)
        return draw_states(self.times, self.states[:, at], None, ax=ax, **how)

    def __repr__(self) -> str:
        return f"<Trajectory: n={self.states.shape[1]}, {show.number_of(self.steps)}>"


class EnsembleTrajectory(_OverTime):
    """Mean and covariance of random trajectories, or of those of several models of a system.

    Attributes
    ----------
    mean : ndarray, shape (K + 1, n)
        ``mean[k]`` is the average of ``x(k)`` over the trajectories.
    variance : ndarray, shape (K + 1, n), or None
        Unbiased variance of one trajectory, entry by entry; None for a single trajectory. Over
        many steps single runs have heavy tails, and a few thousand of them can show far too small
        a variance; `theory.moments.trajectory_covariance` is exact.
    covariance : ndarray, shape (K + 1, n, n), or None
        ``covariance[k]`` is the unbiased covariance of one trajectory at step k; None unless
        asked for, and for a single trajectory.
    runs : ndarray, shape (replicates, K + 1, n), or None
        The trajectories themselves; None unless asked for.
    inputs : ndarray, shape (K, m)
        ``inputs[k]`` is ``u(k)``.
    times : ndarray, shape (K + 1,)
        ``k dt`` [s], or k if the system states no step length.
    size : int
        Realizations N of every entity at every step; the number of models for "systems".
    replicates : int
        Independent trajectories behind the moments: N for "runs" and "systems".
    averaging : str
        "runs", "mean-field", or "systems" for the models of a SystemEnsemble.
    sampled : tuple of str
        Which of "A", "B", "x0" were drawn; the others were exact.
    dt : float or None
        The step length [s]; None if the system states none.
    key : Key or None
        The same key, with the same other arguments, repeats the result; None for "systems", of
        which nothing is drawn.
    status : str
        "completed".
    centre : {"truth", "estimate"} or None
        For "systems": what the models scatter about, as in `SystemEnsemble`. With "estimate" the
        spread is that of the estimate, and no statement about the true trajectory.
    labels : Labels or None
        Names and units of the states and inputs, as those of the system.
    """

    _drawn = "mean"

    mean: Annotated[Floats, "step+1 state"]
    variance: Annotated[Floats, "step+1 state", "own unit"] | None
    covariance: Annotated[Floats, "step+1 state other_state", "own unit"] | None
    runs: Annotated[Floats, "run step+1 state"] | None
    inputs: Annotated[Floats, "step input"]
    times: Annotated[Floats, "step+1"]
    size: Count
    replicates: Count
    averaging: str
    sampled: tuple[str, ...]
    dt: Positive | None
    key: Key | None
    status: str = "completed"
    centre: Centre | None = None
    labels: Labels | None = None

    def _check(self) -> None:
        if self.runs is not None and len(self.runs) != self.replicates:
            raise ShapeError(f"`runs` must be {self.replicates}, got {len(self.runs)}")

    @property
    def standard_error(self) -> Floats | None:
        """The estimated rms error of `mean`, ``sqrt(variance / replicates)``, shape (K + 1, n).

        None for a single trajectory.
        """
        variance = self.variance
        return None if variance is None else np.asarray(np.sqrt(variance / self.replicates))

    def plot(
        self, states: str | int | Sequence[str | int] | None = None, *, ax: Axes | None = None
    ) -> Axes:
        """Draw the mean of every state over time, with a band of two standard errors.

        For the models of a SystemEnsemble the band is two standard deviations of the models.

        Parameters
        ----------
        states : str, int or list of them, optional
            Which states, by name or number. Default: all.
        ax : matplotlib Axes, optional
            Where to draw, as for `Trajectory.plot`.

        Returns
        -------
        matplotlib Axes

        Raises
        ------
        ImportError
            matplotlib is not installed.

        Examples
        --------
        >>> import stochens_rs as se
        >>> path = se.simulate_ensemble(([[0.5]], [[1.0]]), [2.0], [[1.0]], 100, rng=1)
        >>> path.plot().get_xlabel()
        'step k'
        """
        at, how = self._shown(states)
        error = self.standard_error
        if self.averaging == "systems":
            error = None if self.variance is None else np.sqrt(self.variance)
            how["band"] = "± 2 standard deviations"
        error = None if error is None else error[:, at]
        return draw_states(self.times, self.mean[:, at], error, ax=ax, **how)

    def __repr__(self) -> str:
        about = "" if self.centre is None else f", about the {self.centre}"
        return (
            f"<EnsembleTrajectory {self.averaging}: n={self.mean.shape[1]}, "
            f"{show.number_of(self.steps)}, N={self.size}, {self.replicates} trajectories{about}>"
        )


Words: TypeAlias = str | Iterable[str]

SAMPLED = ("A", "B", "x0")
_KEEP = ("covariance", "runs")


def simulate(system: System | Any, x0: ArrayLike, u: ArrayLike) -> Trajectory:
    """Simulate the exact system under given inputs.

    Parameters
    ----------
    system : System
        The system, or anything `System.from_any` takes.
    x0 : array_like, shape (n,)
        Initial state ``x(0)``.
    u : array_like, shape (K, m)
        ``u[k]`` is the input between step k and step k + 1; K = 0 is allowed.

    Returns
    -------
    Trajectory
        States ``x(0), ..., x(K)``, inputs and times.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it.
    NonFiniteError
        If a state overflows.
    ResourceError
        If the states do not fit into the memory this process may use.

    Notes
    -----
    ``x(k) = A^k x(0) + sum_{i<k} A^(k-1-i) B u(i)``, evaluated by the recursion (paper,
    Definition 2.1, where the printed products have one factor too many). O(n (n + m)) per step.

    Examples
    --------
    >>> import stochens_rs as se
    >>> system = se.System([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]], dt=0.1)
    >>> se.simulate(system, [0.0, 0.0], [[10.0], [-10.0]]).states
    array([[0. , 0. ],
           [0. , 1. ],
           [0.1, 0. ]])
    """
    checked, start, inputs = checked_motion(system, x0, u)
    running.need("the trajectory", 2 * 8 * (len(inputs) + 1) * checked.n)  # and a copy
    states = _core.trajectory(*columns(checked), start.reshape(1, -1), inputs)
    dt = _dt(checked)
    return Trajectory(states, inputs.copy(), _times(dt, len(inputs)), dt, checked.labels)


def simulate_ensemble(
    system: System | SystemEnsemble | Any,
    x0: ArrayLike,
    u: ArrayLike,
    size: int | None = None,
    *,
    sampled: Words = SAMPLED,
    averaging: Averaging = "runs",
    replicates: int = 1,
    keep: Words = (),
    rng: RngLike = None,
) -> EnsembleTrajectory:
    """Simulate random realizations of a system, or several models of it, under given inputs.

    Parameters
    ----------
    system : System or SystemEnsemble
        The system, or anything `System.from_any` takes. Of a SystemEnsemble each model
        ``(A_s, B_s, c_s)`` is run once, as it is; then `x0`, `u` and `keep` are the only other
        arguments.
    x0 : array_like, shape (n,)
        Initial state; for a SystemEnsemble also (N, n), one for each model.
    u : array_like, shape (K, m)
        ``u[k]`` is the input between step k and step k + 1, the same for all; K = 0 is allowed.
    size : int
        Number of realizations N of every entity at every step, at least 1. Of a SystemEnsemble N
        is the number of models: leave it out.
    sampled : str or sequence of str, default ("A", "B", "x0")
        What is drawn, column by column, such as "A x0"; the rest is exact.
    averaging : {"runs", "mean-field"}, default "runs"
        "runs": N independent runs, averaged at the end. "mean-field": the N realizations of a
        step are averaged before they are applied, which gives one trajectory; for K > 1 its error
        grows much more slowly.
    replicates : int, default 1
        Number of independent trajectories of a mean field; from 2 on, their variance is computed.
    keep : str or sequence of str, default ()
        "covariance": ``n (K + 1)`` times n numbers, for ``n^2`` operations per run and step instead
        of n. "runs": the trajectories, ``8 N (K + 1) n`` bytes; otherwise the memory does not grow
        with N. Or "covariance runs".
    rng : None, int, SeedSequence, Generator, BitGenerator or Key, optional
        Source of randomness; it becomes a 256-bit key that is kept as ``.key``.

    Returns
    -------
    EnsembleTrajectory
        Mean, variance (and covariance) at every step; of a SystemEnsemble over its models, with
        its `centre`.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it.
    NonFiniteError
        If a state or a second moment overflows.
    ResourceError
        If the result does not fit into the memory this process may use.

    Notes
    -----
    "runs": ``x^s(k+1) = A_k^s x^s(k) + B_k^s u(k)`` with new realizations for every run s and
    every step k (paper, Definition 2.1, corrected: the index maps must be injective in both; one
    realization kept over time gives a biased mean). "mean-field":
    ``F(k+1) = A_hat_k F(k) + B_hat_k u(k)`` with averages of N new realizations at each step.
    The mean of both is the exact trajectory. With ``g_j = ||a_j||_1``,
    ``T_A(d) = diag(|A| (g d)) - A diag(d) A^T`` and ``d_k = diag S_k + x(k)^2``, the covariance
    follows ``S_{k+1} = A S_k A^T + c (T_A(d_k) + T_B(u(k)^2))``, ``S_0 = c Cov(x0)``, where c = 1
    for one run and c = 1/N for a mean field. A run's variance grows by about ``rho(|A| diag g)``
    per step, the signal by ``rho(A)^2``.

    A run takes one draw per step for every nonzero state and input: O(n + m) per run and step, and
    O(1) without inputs, because its state then has one nonzero entry. A mean field costs
    O(n (n + m)) per step for any N. Run s depends on (key, s) only, for any number of threads;
    with a larger ``size`` the first runs are the same.

    A SystemEnsemble: ``x^s(k+1) = A_s x^s(k) + B_s u(k) + c_s``, with the terms added in this
    order, O(n (n + m)) per model and step. Its moments are those of the models given. The mean of
    the runs is not the run of their mean: from the second step on it has the moments of A in it.

    Examples
    --------
    >>> import numpy as np, stochens_rs as se
    >>> system = se.System([[0.9, 0.2], [-0.1, 0.8]], [[1.0], [0.5]])
    >>> x0, u = [1.0, 2.0], [[1.0], [0.0], [-1.0]]
    >>> exact = se.simulate(system, x0, u).states
    >>> found = se.simulate_ensemble(system, x0, u, 100_000, rng=1)
    >>> bool(np.all(abs(found.mean - exact) <= 5 * found.standard_error))
    True
    """
    kept = validation.subset("keep", keep, _KEEP)
    if isinstance(system, SystemEnsemble):
        default: dict[str, Any] = {"sampled": SAMPLED, "averaging": "runs", "replicates": 1}
        given = zip(default.items(), (sampled, averaging, replicates), strict=True)
        own = {k: v for (k, one), v in given if not (type(v) is type(one) and v == one)}
        where = "for a SystemEnsemble, whose models are run as they are"
        validation.left_out(where, size=size, rng=rng, **own)
        return _each(system, x0, u, kept)
    checked, start, inputs = checked_motion(system, x0, u)
    count = validation.size("size", size)
    names = validation.subset("sampled", sampled, SAMPLED)
    mean_field = validation.choice("averaging", averaging, AVERAGINGS) == "mean-field"
    repeats = validation.size("replicates", replicates)
    if not mean_field and repeats != 1:
        raise InputError(f"`replicates` must be 1 for averaging='runs', got {repeats}: use `size`")
    trajectories = repeats if mean_field else count
    n, m = checked.n, checked.m
    tables = 16 * (n + m) * (n + (1 << (n - 1).bit_length()))  # laws of the columns of A and B
    options = _checked_memory(n, len(inputs), trajectories, tables, kept)
    key = as_key(rng)
    found = _core.simulate_runs(
        *columns(checked),
        start.reshape(1, -1),
        inputs,
        ("A" in names, "B" in names, "x0" in names),
        count,
        repeats if mean_field else None,
        *options[:2],
        bytes(key),
        options[2],
    )
    return EnsembleTrajectory(
        **_arrays(found, inputs, _dt(checked)),
        size=count,
        replicates=trajectories,
        averaging="mean-field" if mean_field else "runs",
        sampled=names,
        key=key,
        labels=checked.labels,
    )


def _each(
    models: SystemEnsemble, x0: ArrayLike, u: ArrayLike, kept: tuple[str, ...]
) -> EnsembleTrajectory:
    """Run each of several systems once."""
    N, n, m = models.size, models.n, models.m
    names = models.labels or default_labels(n, m)
    start = validation.starts(x0, N, n, names.states)
    inputs = validation.inputs("u", u, cols=m, labels=names.inputs)
    options = _checked_memory(n, len(inputs), N, models.A.nbytes + models.B.nbytes, kept)
    A, B = (np.ascontiguousarray(M.transpose(0, 2, 1)) for M in (models.A, models.B))
    found = _core.simulate_systems(
        A.reshape(N, n * n), B.reshape(N, m * n), models.c, start, inputs, *options
    )
    return EnsembleTrajectory(
        **_arrays(found, inputs, models.dt),
        size=N,
        replicates=N,
        averaging="systems",
        sampled=(),
        key=None,
        centre=models.centre,
        labels=names,
    )


def _arrays(found: tuple[Any, ...], inputs: Floats, dt: float | None) -> dict[str, Any]:
    """The fields that the core computed."""
    mean, variance, covariance, runs = found
    return {
        "mean": mean,
        "variance": variance,
        "covariance": None if covariance is None else covariance.reshape(*mean.shape, -1),
        "runs": runs.reshape(-1, *mean.shape) if runs.size else None,
        "inputs": inputs.copy(),
        "times": _times(dt, len(inputs)),
        "dt": dt,
    }


def columns(system: System) -> tuple[Floats, Floats]:
    """The columns of A and B as rows; refuses those whose 1-norm overflows."""
    for name, matrix in (("A", system.A), ("B", system.B)):
        with np.errstate(over="ignore"):
            norms = np.abs(matrix).sum(axis=0)
        if not np.isfinite(norms).all():
            j = int(np.argmin(np.isfinite(norms)))
            raise NonFiniteError(f"`{name}[:, {j}]` has a 1-norm that overflows: scale it down")
    return np.ascontiguousarray(system.A.T), np.ascontiguousarray(system.B.T)


def _dt(system: System) -> float | None:
    return system.dt if isinstance(system.dt, float) else None


def _times(dt: float | None, steps: int) -> Floats:
    return np.asarray((dt or 1.0) * np.arange(steps + 1, dtype=np.float64))


def _checked_memory(
    n: int, steps: int, trajectories: int, tables: int, kept: tuple[str, ...]
) -> tuple[bool, bool, int]:
    """Check what the core allocates; what is kept, and the number of threads.

    Moments are added up in a binary tree of partial sums, one per thread and level of the tree.
    """
    full, runs, threads = "covariance" in kept, "runs" in kept, running.get_num_threads()
    sums = 8 * (steps + 1) * n * (1 + (n if full else 1))  # mean and (co)variance
    partial = threads + trajectories.bit_length() + 2
    room = 8 * trajectories * (steps + 1) * n if runs else 0
    work = 1024 * n * threads  # states of the runs of a thread
    running.need(
        f"the moments{' and the runs' if runs else ''} of {trajectories} trajectories",
        sums * partial + tables + room + work,
    )
    return full, runs, threads
