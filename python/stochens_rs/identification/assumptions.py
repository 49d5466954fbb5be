"""What is declared of measured runs, never inferred: `Noise`, `Window`, `Pilot`, `Misfit`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, TypeAlias

import numpy as np

from .. import _core
from .._base import show, validation
from .._base.names import Labels
from .._base.records import FromZero, NotNegative, Options, Positive, Record, trusted
from .._base.running import get_num_threads
from .._base.types import ArrayLike, Floats
from ..exceptions import InputError
from ..theory.exact import EPS

Design: TypeAlias = Literal["independent", "adaptive"]
NoiseLaw: TypeAlias = Literal["gaussian", "sub-gaussian", "bounded"]
Covariance: TypeAlias = Literal["full", "diagonal", "scalar", "known"]

COVARIANCES: dict[Covariance, str] = {
    "full": "one unknown covariance",
    "diagonal": "one unknown diagonal covariance",
    "scalar": "covariance sigma^2 I, sigma unknown",
    "known": "known covariance",
}
UNKNOWN = ("full", "diagonal", "scalar")  # covariances that are estimated
#: What `sigma` is for the laws that need it.
SIZES: dict[NoiseLaw, str] = {"sub-gaussian": "", "bounded": ", the largest norm of the noise"}
SMALLEST, LARGEST = 1e-100, 1e100  # of sizes that are squared
LONGEST = 2**16  # of lags, filters and delays
#: The tests in the order in which they are named: first what explains the others.
FAULTS = (
    "equal rows",
    "spikes",
    "wrap",
    "clipped",
    "late rows",
    "dead time",
    "offset",
    "ends",
    "starts",
    "memory",
    "nonlinear",
    "outliers",
    "change",
    "drift",
    "variance",
    "noise size",
    "noise shape",
)
ACCEPTED = (*FAULTS, "no effect")
ROUNDING = EPS  # times n^2: least eigenvalues of correlation matrices up to here may be 0


class Noise(Options):
    """The noise w(k) of ``x(k+1) = A x(k) + B u(k) + c + w(k)``, of mean 0, as you declare it.

    Attributes
    ----------
    law : {"gaussian", "sub-gaussian", "bounded"}, default "gaussian"
        "sub-gaussian": ``E exp(l' w) <= exp(sigma^2 ||l||^2 / 2)`` given the past. "bounded":
        ``||w||_2 <= sigma``.
    covariance : {"full", "diagonal", "scalar"} or array_like of shape (n, n), default "full"
        Of Gaussian noise: one unknown matrix, an unknown diagonal one, an unknown multiple of I, or
        the matrix itself, which may be singular with a `Pilot`. For "sub-gaussian" noise a matrix
        in place of ``sigma^2 I``.
    sigma : float, optional
        The known size of the noise, see `law`: for Gaussian noise the covariance is
        ``sigma^2 I``.
    exact : sequence of str or int, default ()
        States, by name or number, without noise of their own: it is 0, or a combination of that of
        the other states, as where one force disturbs position and velocity, or for the states of a
        Kalman filter in its steady state. Not for columns that were computed from others, as
        velocities by finite differences: they are no states. Rows of which the whole state matrix
        is in `known` count as declared.
    design : {"adaptive", "independent"}, default "adaptive"
        "adaptive": inputs and states may depend on earlier noise, as in every run of more than one
        step. "independent": all states and inputs of the pairs are independent of all noise in
        `x_next`; for pairs only (`Trajectories.from_pairs`, `Trajectories.last_pairs`).

    Raises
    ------
    InputError, InputTypeError
        If a value cannot be used, or two do not go together.

    Examples
    --------
    >>> import stochens_rs as se
    >>> se.Noise(sigma=0.01)
    Noise(sigma=0.01)
    """

    law: NoiseLaw = "gaussian"
    covariance: str | Floats = "full"
    sigma: float | None = None
    exact: tuple[str | int, ...] = ()
    design: Design = "adaptive"

    def __post_init__(self) -> None:
        if isinstance(self.covariance, str):
            validation.choice("covariance", self.covariance, UNKNOWN)
        else:
            self._keep(covariance=validation.matrix("covariance", self.covariance))
            if np.abs(self.covariance).max() > LARGEST:
                raise InputError(f"`covariance` must have entries up to {LARGEST:g}")
        one = isinstance(self.exact, str)
        self._keep(exact=(self.exact,) if one else tuple(validation.items("exact", self.exact)))
        if self.sigma is not None:
            if not isinstance(self.covariance, str) or self.covariance == "diagonal":
                raise InputError("`sigma` and `covariance` must not be given both")
            self._keep(sigma=validation.positive("sigma", self.sigma, maximum=LARGEST))
            if self.sigma < SMALLEST:
                raise InputError(f"`sigma` must be at least {SMALLEST:g}, got {self.sigma:g}")
        super().__post_init__()
        known = self.sigma is not None or not isinstance(self.covariance, str)
        if self.law in SIZES and (not known or (SIZES[self.law] and self.sigma is None)):
            raise InputError(f"`sigma` must be given for law='{self.law}'{SIZES[self.law]}")


class Window(Options, eq=True):
    """The part of the past from which a model predicts, as you declare it.

    At most one of `lags` and `filters` is given, for outputs. Without one the first quarter of the
    pairs chooses, and counts no more: what Akaike's criterion asks for, and half as much again.
    Filters that predict the end of this quarter, fitted to what came before, with twice the error
    of lags give way to lags.

    Attributes
    ----------
    lags : int or "auto", optional
        The last so many readings and inputs.
    filters : (float, int), optional
        Pole in (0, 1) and number of filters in a row, which reach further back with fewer unknowns.
    delay : int or (int, int), default 0
        The dead time: after how many steps an input acts. A pair is a range, of which the first
        quarter of the pairs chooses. Of states, the model is then one of the states now and the
        inputs under way, ``x(k+1) = A x(k) + B u(k - delay) + c + w(k)``; what takes a `record`
        takes states and inputs measured. -1: a row of the data holds the states *after* its input,
        so that the inputs are moved by one row.
    tail : float, default 0.0
        What the model leaves out of the outcomes beside their noise, as the part of readings that
        reaches further back than the window: at most this in root mean square over the pairs, in
        deviations of the noise. Nothing in the data bounds it: 0 is your declaration that the
        window is long enough.

    Raises
    ------
    InputError, InputTypeError
        If a value cannot be used, or two do not go together.

    Examples
    --------
    >>> import stochens_rs as se
    >>> se.Window(filters=(0.8, 4), delay=1)
    Window(filters=(0.8, 4), delay=1)
    """

    lags: int | Literal["auto"] | None = None
    filters: tuple[float, int] | None = None
    delay: int | tuple[int, int] = 0
    tail: NotNegative = 0.0

    def __post_init__(self) -> None:
        if len(self.given) > 1:
            raise InputError("only one of `lags` and `filters` must be given, got both")
        if self.lags is not None and not isinstance(self.lags, str):
            self._keep(lags=validation.size("lags", self.lags, maximum=LONGEST))
        if self.filters is not None:
            pole, count = _pair("filters", self.filters, "a pair (pole, number), as (0.8, 4)")
            pole = validation.probability("filters[0]", pole)
            count = validation.size("filters[1]", count, maximum=LONGEST)
            self._keep(filters=(pole, count))
        if isinstance(self.delay, (tuple, list)):
            least, most = _pair("delay", self.delay, "a number or a pair of them")
            least = validation.size("delay[0]", least, minimum=0)
            most = validation.size("delay[1]", most, minimum=least, maximum=LONGEST)
            self._keep(delay=(least, most))
        else:
            delay = validation.size("delay", self.delay, minimum=-1, maximum=LONGEST)
            self._keep(delay=delay)
        super().__post_init__()
        if isinstance(self.delay, tuple) and (self.filters or isinstance(self.lags, int)):
            raise InputError(
                f"`delay` must be one number with `{self.given[0]}`, which is no choice"
            )

    @property
    def delays(self) -> tuple[int, int]:
        """The least and the largest delay."""
        return self.delay if isinstance(self.delay, tuple) else (self.delay, self.delay)

    @property
    def given(self) -> list[str]:
        """Which of `lags` and `filters` is given."""
        return [name for name in ("lags", "filters") if getattr(self, name) is not None]


class Pilot(Options):
    """Runs whose error has an exact law, whatever their length, as you declare it.

    Gaussian noise; number and lengths of runs fixed beforehand; starts measured without error and
    independent of the noise of all runs; `inputs` as declared. The pilot repeats the runs on paper,
    and the model is estimated with what it predicts as instruments. For inputs by any feedback the
    pairs are weighted after their past instead, and starts are free.

    Attributes
    ----------
    source : float, int, model or system
        A share (0.1) or number of the first runs, which are then not used otherwise: at least two,
        two pairs for each unknown, and five where 3/10 of the runs have so many. Or a model or
        system from elsewhere, as of an older plant: right or wrong, but not of these runs.
    reference : (x0, xf, steps) or Plan, optional
        The task that plans will be about, fixed without the runs of the model: never a state that
        they led to. `Plan.bound` of a plan of as many steps is then close to the error itself where
        the plan is near the pilot's; starts and targets are free. For outputs a Plan.
    gain : Loop, optional
        The feedback that plans will be followed with, made for the model of the pilot by the rule
        that makes it for the model: `Plan.bound(gain=)` is then near the reference.
    inputs : "open loop", "any" or array_like of shape (m, n), default "open loop"
        How the inputs of the runs were made: independent of the noise, or ``gain x + dither`` with
        this gain, or by any feedback, for runs in the order of time: `source` is then a share or
        number of runs.
    dither : array_like, shape (N, m), optional
        What was added to the feedback, as it was recorded, not computed from u and x.
    lengths_fixed : bool, default False
        Your declaration that runs of unequal length are so by plan: their lengths were fixed
        beforehand, and no run was ended because of what was measured; with inputs="any" also that
        rows that are missing were lost by chance.

    Raises
    ------
    InputError, InputTypeError
        If a value cannot be used, or two do not go together.

    Examples
    --------
    >>> import stochens_rs as se
    >>> se.Pilot(0.1, reference=([1.0], [0.0], 5))
    Pilot(source=0.1, reference=([1.0], [0.0], 5))
    """

    source: Any
    reference: Any = None
    inputs: str | Floats = "open loop"
    dither: Floats | None = None
    lengths_fixed: bool = False
    gain: Any = None

    @property
    def past(self) -> bool:
        """Whether pairs are weighted after their past."""
        return isinstance(self.inputs, str) and self.inputs == "any"

    def __post_init__(self) -> None:
        if self.source is None:
            raise InputError(
                "`source` must be a share, a number of runs, a model or a system, got None"
            )
        open_loop = isinstance(self.inputs, str)
        if open_loop:
            validation.choice("inputs", self.inputs, ("open loop", "any"))
        else:
            self._keep(inputs=validation.matrix("inputs", self.inputs))
        if open_loop != (self.dither is None):
            raise InputError(
                "`dither` must be given with a gain as `inputs`, and be left out without one"
            )
        if self.past and not validation.is_real(self.source):
            raise InputError(
                "`source` must be a share or a number of the first runs with inputs='any', got "
                f"{validation.show(self.source)}"
            )
        if self.gain is not None and (self.reference is None or not hasattr(self.gain, "K")):
            raise InputError(
                "`gain` must be a Loop, as by `gain`, beside a `reference`, got "
                f"{validation.show(self.gain)}"
            )
        if self.dither is not None:
            self._keep(dither=validation.matrix("dither", self.dither))
        super().__post_init__()


def _pair(name: str, value: Any, what: str) -> Any:
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise InputError(f"`{name}` must be {what}, got {validation.show(value)}")
    return value


def as_noise(noise: Any) -> Noise:
    """`noise` itself, or that of a number as its `sigma`, or the default for None."""
    if validation.is_real(noise):
        return Noise(sigma=noise)
    return GAUSSIAN if noise is None else validation.instance("noise", noise, Noise)


GAUSSIAN, ANY = Noise(), Window()  # where nothing is declared


class Assumptions(Record):
    """What is assumed about the data; `identify` says what each word means.

    Attributes
    ----------
    design : {"independent", "adaptive"}
        Whether all z are independent of all noise.
    noise : {"gaussian", "sub-gaussian", "bounded"}
        The law of the noise.
    covariance : {"full", "diagonal", "scalar", "known"}
        What is known of its covariance.
    known : ndarray, shape (n, n), or None
        The covariance, if it is known; for other noise than Gaussian an upper bound.
    exact : tuple of int
        The states without noise of their own: it is 0, or a combination of that of other states.
    tail : float
        What the model leaves out beside the noise, in root mean square and deviations of the noise.
    accept : tuple of str
        The tests of which a failure is accepted, by name.
    """

    design: Design
    noise: NoiseLaw
    covariance: Covariance
    known: Floats | None = None
    exact: tuple[int, ...] = ()
    tail: NotNegative = 0.0
    accept: tuple[str, ...] = ()

    def _check(self) -> None:
        if (self.covariance == "known") != (self.known is not None):
            raise InputError("`known` must be the covariance where it is known, and only there")
        if self.known is not None:
            n = len(self.known)
            if (checked_covariance("known", self.known, n, semi=True) != self.known).any():
                raise InputError("`known` must be symmetric")
        if self.known is None and self.noise in SIZES:
            raise InputError(f"`known` must be given for {self.noise} noise")
        if list(self.exact) != sorted({validation.size("exact", i, minimum=0) for i in self.exact}):
            raise InputError("`exact` must be different states in their order")
        if self.accept != checked_accept(self.accept):
            raise InputError("`accept` must be names of tests in their order")

    @property
    def design_text(self) -> str:
        """The assumption on the inputs behind the sizes of a model; "" if there is none."""
        return "" if self.design == "adaptive" else ", independent design"

    @property
    def declared(self) -> tuple[str, Floats | None]:
        """For the core, the covariance that is to be estimated, or the law of the known one."""
        return (self.covariance, None) if self.known is None else (self.noise, self.known)

    @property
    def text(self) -> str:
        """The assumption on the noise in words."""
        if self.noise != "gaussian":
            return f"{self.noise} noise of a known bound"
        return f"Gaussian noise of {COVARIANCES[self.covariance]}"


def checked_assumptions(
    noise: Noise,
    names: Sequence[str],
    singular: bool = False,
    tail: float = 0.0,
    accept: object = (),
) -> Assumptions:
    """What is declared of states of these names; `singular`: the covariance may be semidefinite."""
    n = len(names)
    known, word = None, "known"
    if noise.sigma is not None:
        known = noise.sigma**2 * np.eye(n)
    elif isinstance(noise.covariance, str):
        word = noise.covariance
    else:
        known = checked_covariance("covariance", noise.covariance, n, semi=singular)
    exact = {
        names.index(validation.choice("exact", one, tuple(names)))
        if isinstance(one, str)
        else validation.size("exact", one, minimum=0, maximum=n - 1)
        for one in noise.exact
    }
    found = tuple(sorted(exact)), tail, checked_accept(accept)
    return trusted(Assumptions, noise.design, noise.law, word, known, *found)  # type: ignore[arg-type]


def checked_accept(accept: object) -> tuple[str, ...]:
    """The names of tests in `accept`, in the order of `ACCEPTED`."""
    given = [accept] if isinstance(accept, str) else validation.items("accept", accept)
    names = {validation.choice("accept", one, ACCEPTED) for one in given}
    return tuple(one for one in ACCEPTED if one in names)


def checked_scale(scale: Any, count: int, offset: bool) -> Floats:
    """The expected sizes of x and u, and 1 for the offset."""
    if validation.is_real(scale):
        scale = np.full(count, validation.positive("scale", scale))
    sizes = validation.vector("scale", scale, length=count)
    wrong = sizes[(sizes < SMALLEST) | (sizes > LARGEST)]
    if len(wrong):
        raise InputError(f"`scale` must be in [{SMALLEST:g}, {LARGEST:g}], got {wrong[0]:g}")
    return np.concatenate([sizes, np.ones(int(offset))])


def require_known(name: str, known: Floats) -> None:
    """Refuse known entries that are neither nan nor numbers of a usable size."""
    if not (np.isnan(known) | (np.abs(known) <= LARGEST)).all():
        raise InputError(
            f"`{name}` must contain numbers up to {LARGEST:g}, or nan for what is to estimate"
        )


def checked_covariance(name: str, value: Any, n: int, *, semi: bool = False) -> Floats:
    """A symmetric matrix that is positive definite, or semidefinite up to rounding."""
    given = validation.matrix(name, value, rows=n, cols=n)
    if not np.allclose(given, given.T, rtol=1e-9, atol=0.0):
        raise InputError(f"`{name}` must be symmetric")
    least = least_correlation(given)
    if least < (-ROUNDING if semi else ROUNDING) * n * n:
        raise InputError(
            f"`{name}` must be positive {'semi' * semi}definite, an eigenvalue is {least:.3g}"
        )
    return (given + given.T) / 2.0


def least_correlation(given: Floats) -> float:
    """The least eigenvalue in units in which the diagonal is 1: the same in all units."""
    sizes = np.sqrt(np.abs(np.diag(given)))
    sizes = np.where(sizes == 0.0, 1.0, sizes)
    return float(np.linalg.eigvalsh(given / sizes[:, None] / sizes)[0])


def refuse(assumed: Assumptions, n: int, single: bool) -> None:
    """Refuse assumptions that do not fit to n states; `single`: every run is one pair."""
    if assumed.design == "independent" and not single:
        raise InputError(
            "`design` must be 'adaptive' for runs of several steps: else use data.last_pairs()"
        )
    if assumed.tail and assumed.design == "independent":
        raise InputError("`tail` must be 0 for an independent design")
    if any(state >= n for state in assumed.exact):
        raise InputError(f"`exact` must have numbers of states, below {n}")


def require_triangle_of(rows: Floats, triangle: Floats) -> None:
    """Refuse a triangle R with another ``R' R`` than that of the rows W.

    Householder's QR has an error of a few (N + w) w EPS of each column (Higham 2002, theorem 19.4).
    """
    if np.tril(triangle, -1).any():
        raise InputError("`triangle` must be upper triangular")
    N, w = rows.shape
    fresh = _core.triangle(rows, get_num_threads())
    sizes = np.abs(fresh).max(axis=0)  # no square overflows
    sizes = np.where(sizes == 0.0, 1.0, sizes)
    with np.errstate(over="ignore", invalid="ignore"):
        mine, theirs = fresh / sizes, triangle / sizes
        far = np.abs(mine.T @ mine - theirs.T @ theirs).max()
    if not far <= 8.0 * (N + w) * w * EPS:
        raise InputError("`triangle` must be that of the data")


class Misfit(Options):
    """A term ``f(z, k)`` in ``x(k+1) = A x(k) + B u(k) + f + w(k)`` that no linear model has.

    It may be nonlinear, change from step to step and depend on the past, but not on noise to come.
    You declare its size, of one step of the model. A law in continuous time is spread over all
    states by sampling, and mixes in the inputs: ``on`` all states, ``of`` both, is then the safe
    choice.

    Attributes
    ----------
    on : str, sequence of str, or array_like of shape (n,)
        The states that it is added to; or the direction of one number in all states, such as
        ``(0, 0, -0.17, 1)`` for gravity in the speed and rate of a pendulum on a cart.
    of : str or sequence of str
        z: the states and inputs that it is a function of.
    at_most : float
        ``||f|| <= at_most ||z||^power`` for ``||z|| <= within``, in the units of the data.
    power : float, default 1
        At least 1; 3 for what a sine or a spring leaves out: ``|sin z - z| <= |z|^3 / 6``.
    within : float, default inf
        Where that is true. Certificates are then of motions that stay there, which they prove.
    cut : float, optional
        Pairs with ``||z||`` above this are left out of the data: a rule on what came before the
        step. Fix it beforehand. Default: `within`.

    Raises
    ------
    InputError, InputTypeError
        If a value cannot be used.

    Notes
    -----
    With ``phi^2`` the sum of the bounds of ``||f||^2`` over the pairs the error of least squares
    grows to ``(1 + t) rho^2 S + (1 + 1/t) phi^2 E E'``, E the direction, for known noise; t is the
    best of the sum of both in units of S. In use f is a block beside the region. See "How much can
    go wrong?". The log is still tested: where the term shows in the data, "nonlinear" fails, or
    "noise size", and nothing is certified until ``accept="nonlinear"`` of `identify` says that the
    declaration covers all of what was found.

    Examples
    --------
    >>> import stochens_rs as se
    >>> se.Misfit(on="rate", of="angle", at_most=0.2, power=3, within=0.5)
    Misfit(on='rate', of='angle', at_most=0.2, power=3.0, within=0.5)
    """

    on: str | tuple[str, ...] | Floats
    of: str | tuple[str, ...]
    at_most: NotNegative
    power: Positive = 1.0
    within: FromZero = np.inf
    cut: FromZero | None = None

    def __post_init__(self) -> None:
        for name in ("on", "of"):
            value = getattr(self, name)
            if isinstance(value, (list, tuple)) and all(isinstance(one, str) for one in value):
                self._keep(**{name: tuple(value)})
            elif name == "on" and not isinstance(value, str):
                self._keep(on=validation.vector("on", value))
        super().__post_init__()
        if self.power < 1.0 or (self.power > 1.0 and self.within == np.inf):
            raise InputError("`power` must be at least 1, and with one above 1 `within` be finite")
        if not self.gamma <= 1e100:
            raise InputError("`at_most` and `power` must give a term of size below 1e100 ||z||")
        if self.cut is not None and self.cut > self.within:
            raise InputError("`cut` must be at most `within`, where the bound is true")

    @property
    def limit(self) -> float:
        """The size of z above which pairs are left out."""
        return self.within if self.cut is None else self.cut

    @property
    def gamma(self) -> float:
        """``||f|| <= gamma ||z||`` for all z up to `within`."""
        far = self.within if self.power > 1.0 else 1.0
        with np.errstate(over="ignore", invalid="ignore"):
            return float(self.at_most * np.float64(far) ** (self.power - 1.0))

    @property
    def text(self) -> str:
        """The declaration in words."""
        of = show.listed([self.of] if isinstance(self.of, str) else self.of)
        on = (
            f"direction {show.vector(self.on)}"
            if isinstance(self.on, np.ndarray)
            else (self.on if isinstance(self.on, str) else show.listed(self.on))
        )
        size = f"{self.at_most:g} ||z||{f'^{self.power:g}' if self.power > 1.0 else ''}"
        zone = f" for ||z|| <= {self.within:g}" if self.within < np.inf else ""
        return f"a term of size up to {size}, z = ({of}), in {on}{zone}, in the data and in use"


def block_of(misfit: Misfit, labels: Labels) -> tuple[Floats, Floats, float]:
    """Its direction (n, k), z as rows of (x, u), and `gamma`."""
    direction, signals = directions_of("on", misfit.on, labels), signals_of("of", misfit.of, labels)
    return direction, signals, misfit.gamma


def sizes_of(misfit: Misfit, z: Floats, labels: Labels) -> Floats:
    """``||z||`` in rows of (x, u)."""
    rows = signals_of("of", misfit.of, labels)
    return np.asarray(np.linalg.norm(z[:, : rows.shape[1]] @ rows.T, axis=1))


def grown(misfit: Misfit, part: _core.RegionPart, z: Floats, labels: Labels) -> _core.RegionPart:
    """The part of a region for data with the misfit, z (N, d)."""
    each = misfit.at_most * sizes_of(misfit, z, labels) ** misfit.power
    lengths = np.linalg.norm(z[:, part.columns] @ part.white.T, axis=1)
    phi = min(float(np.linalg.norm(each)), float(each @ lengths)) * (1.0 + 1e-9)
    E = directions_of("on", misfit.on, labels)
    S, more = part.factor * part.S, phi**2 * (E @ E.T)
    if phi > 0.0:
        share = float(np.sqrt(np.trace(np.linalg.solve(S, more)) / len(S)))
        S = (1.0 + share) * S + (1.0 + 1.0 / share) * more
    fields = part.__reduce__()[1]
    return _core.RegionPart(*fields[:-2], np.ascontiguousarray((S + S.T) / 2.0), 1.0)  # type: ignore[call-arg,arg-type]


def signals_of(name: str, of: str | Sequence[str], labels: Labels) -> Floats:
    """The rows of (x, u) with these names, (l, n + m)."""
    known = (*labels.states, *labels.inputs)
    asked = [of] if isinstance(of, str) else validation.items(name, of)
    places = [known.index(validation.choice(name, one, known)) for one in asked]
    if not places or len(set(places)) < len(places):
        raise InputError(f"`{name}` must name states or inputs, each once, got {of!r}")
    return np.eye(len(known))[places]


def directions_of(name: str, on: ArrayLike | str | Sequence[str], labels: Labels) -> Floats:
    """Columns of states: units of those with these names, or one direction, (n, k)."""
    named = [on] if isinstance(on, str) else on
    if isinstance(named, (list, tuple)) and all(isinstance(one, str) for one in named):
        chosen = signals_of(name, named, Labels(labels.states, ()))
        return np.ascontiguousarray(chosen.T)
    direction = validation.vector(name, on, length=len(labels.states), labels=labels.states)
    if not direction.any():
        raise InputError(f"`{name}` must have an entry other than 0")
    return direction[:, None].copy()
