"""`Noise`, `Window` and `Pilot`: what is declared of measured runs, never inferred."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

from .._base import validation
from .._base.records import Options
from .._base.types import Floats
from ..exceptions import InputError

Design: TypeAlias = Literal["independent", "adaptive"]
NoiseLaw: TypeAlias = Literal["gaussian", "sub-gaussian", "bounded"]

DESIGNS: tuple[Design, ...] = get_args(Design)
LAWS: tuple[NoiseLaw, ...] = get_args(NoiseLaw)
UNKNOWN = ("full", "diagonal", "scalar")  # covariances that are estimated
#: What `sigma` is for the laws that need it.
SIZES: dict[NoiseLaw, str] = {"sub-gaussian": "", "bounded": ", the largest norm of the noise"}
SMALLEST, LARGEST = 1e-100, 1e100  # of sizes that are squared
LONGEST = 2**16  # of lags, filters and delays


@dataclass(frozen=True, eq=False, repr=False)
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
        is in `known_A` count as declared.
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
        validation.choice("law", self.law, LAWS)
        validation.choice("design", self.design, DESIGNS)
        if isinstance(self.covariance, str):
            validation.choice("covariance", self.covariance, UNKNOWN)
        else:
            self._keep(covariance=validation.matrix("covariance", self.covariance))
        if self.sigma is not None:
            if not isinstance(self.covariance, str) or self.covariance == "diagonal":
                raise InputError("`sigma` and `covariance` must not be given both")
            size = validation.positive("sigma", self.sigma, maximum=LARGEST)
            if size < SMALLEST:
                raise InputError(f"`sigma` must be at least {SMALLEST:g}, got {size:g}")
            self._keep(sigma=size)
        known = self.sigma is not None or not isinstance(self.covariance, str)
        if self.law in SIZES and (not known or (SIZES[self.law] and self.sigma is None)):
            raise InputError(f"`sigma` must be given for law='{self.law}'{SIZES[self.law]}")
        one = isinstance(self.exact, str)
        self._keep(exact=(self.exact,) if one else tuple(validation.items("exact", self.exact)))
        super().__post_init__()


@dataclass(frozen=True, repr=False)
class Window(Options):
    """From which part of the past a model predicts, as you declare it.

    At most one of `lags`, `filters` and `order` is given, for outputs. Without one the first
    quarter of the pairs chooses, and counts no more: what Akaike's criterion asks for, and half as
    much again.

    Attributes
    ----------
    lags : int or "auto", optional
        The last so many readings and inputs.
    filters : (float, int), optional
        Pole in (0, 1) and number of filters in a row, which reach further back with fewer unknowns.
    order : "auto", optional
        The default, written out.
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
    order: Literal["auto"] | None = None
    delay: int | tuple[int, int] = 0
    tail: float = 0.0

    def __post_init__(self) -> None:
        given = self.given
        if len(given) > 1:
            raise InputError(
                f"only one of `lags`, `filters` and `order` must be given, got {given}"
            )
        if self.lags is not None and not isinstance(self.lags, str):
            self._keep(lags=validation.size("lags", self.lags, maximum=LONGEST))
        elif self.lags is not None:
            validation.choice("lags", self.lags, ("auto",))
        if self.filters is not None:
            self._keep(filters=_filters(self.filters))
        if self.order is not None:
            validation.choice("order", self.order, ("auto",))
        self._keep(delay=_delay(self.delay), tail=validation.nonnegative("tail", self.tail))
        if isinstance(self.delay, tuple) and (self.filters or isinstance(self.lags, int)):
            raise InputError(
                f"`delay` must be one number with `{given[0]}`: a range is for order='auto'"
            )
        super().__post_init__()

    @property
    def given(self) -> list[str]:
        """Which of `lags`, `filters` and `order` is given."""
        return [name for name in ("lags", "filters", "order") if getattr(self, name) is not None]


@dataclass(frozen=True, eq=False, repr=False)
class Pilot(Options):
    """Runs whose error has an exact law, whatever their length, as you declare it.

    Gaussian noise; number and lengths of runs fixed beforehand; starts measured without error and
    independent of the noise of all runs; `inputs` as declared. The pilot repeats the runs on paper,
    and the model is estimated with what it predicts as instruments.

    Attributes
    ----------
    source : float, int, model or system
        A share (0.1) or number of the first runs, which are then not used otherwise: at least two,
        two pairs for each unknown, and five where 3/10 of the runs have so many. Or a model or
        system from elsewhere, as of an older plant: right or wrong, but not of these runs.
    reference : (x0, xf, steps) or Plan, optional
        The task that plans will be about, fixed without the runs of the model: never a state that
        they led to. `Plan.bound` of a plan of as many steps is then close to the error itself where
        the plan is near the pilot's; starts and targets are free.
    inputs : "open loop" or array_like of shape (m, n), default "open loop"
        How the inputs of the runs were made: independent of the noise, or ``gain x + dither`` with
        this gain.
    dither : array_like, shape (N, m), optional
        What was added to the feedback, as it was recorded, not computed from u and x.
    lengths_fixed : bool, default False
        Your declaration that runs of unequal length are so by plan: their lengths were fixed
        beforehand, and no run was ended because of what was measured.

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

    def __post_init__(self) -> None:
        if self.source is None:
            raise InputError(
                "`source` must be a share, a number of runs, a model or a system, got None"
            )
        validation.flag("lengths_fixed", self.lengths_fixed)
        if isinstance(self.inputs, str):
            validation.choice("inputs", self.inputs, ("open loop",))
            if self.dither is not None:
                raise InputError("`dither` goes with a gain as `inputs`, not with 'open loop'")
        else:
            self._keep(inputs=validation.matrix("inputs", self.inputs))
            if self.dither is None:
                raise InputError(
                    "`dither` must be given with a gain as `inputs`: what was added, as recorded"
                )
            self._keep(dither=validation.matrix("dither", self.dither))
        super().__post_init__()


def _filters(filters: Any) -> tuple[float, int]:
    if not isinstance(filters, (tuple, list)) or len(filters) != 2:
        raise InputError(
            f"`filters` must be a pair (pole, number), as (0.8, 4), got {validation.show(filters)}"
        )
    pole = validation.probability("filters[0]", filters[0])
    return pole, validation.size("filters[1]", filters[1], maximum=LONGEST)


def _delay(delay: Any) -> int | tuple[int, int]:
    """A delay, -1 among them, or the least and the largest one."""
    if not isinstance(delay, (tuple, list)):
        return validation.size("delay", delay, minimum=-1, maximum=LONGEST)
    if len(delay) != 2:
        raise InputError(
            f"`delay` must be a number or a pair of them, got {validation.show(delay)}"
        )
    least = validation.size("delay[0]", delay[0], minimum=0)
    return least, validation.size("delay[1]", delay[1], minimum=least, maximum=LONGEST)


def as_noise(noise: Any) -> Noise:
    """`noise` itself, or that of a number as its `sigma`, or the default for None."""
    if validation.is_real(noise):
        return Noise(sigma=noise)
    return Noise() if noise is None else validation.instance("noise", noise, Noise)


def as_window(window: Any) -> Window:
    """`window` itself, or the default for None."""
    return Window() if window is None else validation.instance("window", window, Window)


def as_pilot(pilot: Any) -> Pilot | None:
    """`pilot` itself, or one of this source; None for None."""
    return pilot if pilot is None or isinstance(pilot, Pilot) else Pilot(pilot)
