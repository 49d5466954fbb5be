"""`Model`: least squares of measured data, and the regions and ensembles that follow."""

from __future__ import annotations

from dataclasses import replace
from math import ceil
from typing import Any, TypeAlias

import numpy as np

from .. import _core
from .._base import running, show, validation
from .._base.names import Labels
from .._base.records import Probability, SavedRecord, cached_property
from .._base.running import get_num_threads
from .._base.types import DELTA, ArrayLike, Figure, Floats, SubFigure
from ..data import Trajectories
from ..ensembles.systems import SystemEnsemble
from ..exceptions import InputError, ShapeError
from ..plots.certificates import draw_residuals
from ..rng import RngLike, as_key
from . import checks as tests
from .assumptions import (
    FAULTS,
    Assumptions,
    Design,
    Misfit,
    block_of,
    checked_scale,
    grown,
    least_correlation,
    refuse,
    require_known,
    require_triangle_of,
)
from .changes import Changes, accepted, unexcited
from .checks import Checks, Tested, cautions
from .identified import Fitted, Identified
from .pilot import PilotModel
from .pilot import refuse as refuse_pilot
from .region import METHODS, Method, Region, Wish, entered, of_core, region_of, said, withheld
from .region import directions as spanned_by
from .region import refuse as refuse_region
from .window import Loop, Regressors, assumed, of_names, rows_of


class Model(SavedRecord, Fitted):
    """A model ``x(k+1) = A x(k) + B u(k) + c`` identified from data, with what was assumed.

    Made by `identify`.

    Attributes
    ----------
    data : Trajectories
        The pairs it was fitted to.
    triangle : ndarray
        R with ``R' R = W' W`` for the rows ``W = (x, u, 1, x_next)`` of all pairs: all that the
        estimate and most regions need.
    assumptions : Assumptions
        Design, noise, covariance and exact states, as declared.
    scale : ndarray, shape (n + m,) or (n + m + 1,), or None
        The sizes of states and inputs that were expected before the data; None: as in the first
        pairs.
    intercept : bool
        Whether there is an offset c.
    known : ndarray, shape (n, n + m) or (n, n + m + 1), or None
        The entries that were declared as known; nan where an entry was estimated.
    checks : Checks or None
        The tests of the residuals; None if there were too few pairs, too many to test them
        without being asked, or `identify` was told not to: see `check`.
    pilot : PilotModel or None
        What simulates the runs of `data` for a region that is exact, see `identify`; the model is
        then not least squares.
    window : Regressors or None
        For models of outputs, the past readings and inputs from which they are predicted; the
        states are then the contents of the window. With a dead time the states now and the inputs
        under way. None for models of states whose inputs act at once.
    first : int
        With a window: how many of the first pairs of `data` say its size, or were used to choose
        it. They count no more: `triangle`, the model and its regions are of those after them.
    misfit : Misfit or None
        What the plant has beside the model, as declared.
    looks : float or None
        Of a `ModelStream`: the probability that any of its regions is wrong, at any look.
    """

    _kind = "model"

    data: Trajectories
    triangle: Floats
    assumptions: Assumptions
    scale: Floats | None = None
    intercept: bool = False
    known: Floats | None = None
    checks: Checks | None = None
    pilot: PilotModel | None = None
    window: Regressors | None = None
    first: int = 0
    misfit: Misfit | None = None
    looks: Probability | None = None

    def _check(self) -> None:
        if self.looks is not None and (self.scale is None or self.first or self.pilot):
            raise InputError("`looks` needs `scale`, and neither a first part nor a pilot")
        if self.misfit is not None:
            beside = self.window, self.pilot, self.known
            require_fit(self.misfit, self.data, self.assumptions, self.scale, beside)
        validation.size("first", self.first, minimum=0, maximum=self.data.size)
        if self.window is None and self.data.outputs:
            raise InputError("`window` must be given for outputs")
        if not self.data.outputs and (self.regressors.count, self.regressors.pole) != (1, None):
            raise InputError("`window` of states must have one lag, and a dead time")
        window = self.regressors
        own = self.outputs, self.input_names, self.intercept
        if (window.outputs, window.inputs, window.intercept) != own:
            raise InputError("`window` must have the outputs, inputs and intercept of the model")
        n, d = self.data.n, window.length
        validation.kept("triangle", self.triangle, shape=(d + n,) * 2)
        if self.scale is not None:
            checked_scale(validation.kept("scale", self.scale, shape=(d,)), d, False)
        if self.known is not None:
            if self.known.shape != (n, d):
                raise ShapeError(f"`known` must have shape ({n}, {d}), got {self.known.shape}")
            require_known("known", self.known)
            if not 0 < np.isnan(self.known).sum() < n * d:
                raise InputError("`known` must have numbers, and nan where an entry was estimated")
        refuse(self.assumptions, n, self.data.single)
        if self.pilot is not None:
            past = self.pilot.root is not None
            refuse_pilot(self.assumptions, self.data, self.known is not None, past)
            validation.kept("pilot.model", self.pilot.model, shape=(n, d))
            if self.pilot.dither is not None:
                validation.kept("pilot.dither", self.pilot.dither, shape=(self.data.size, self.m))

    @cached_property
    def regressors(self) -> Regressors:
        """What it predicts from: `window`, or for states without dead time one lag of them."""
        own = self.data.state_names, self.data.input_names
        return self.window or of_names(*own, self.intercept)

    @cached_property
    def ranges(self) -> Floats:
        """Between the least and largest reading and input of its data, 1 for a constant."""
        found = np.ptp(self.data.rows[:, : self.data.n + self.m], axis=0)
        return validation.frozen(np.where(found > 0.0, found, 1.0))

    @cached_property
    def core(self) -> _core.Identified:
        """What the core finds in the data."""
        scaled = self.scale is not None
        own = self.assumptions, scaled, self.intercept, self.known, self.pilot is not None
        past = self.regressors.core, self.first
        windowed = self.window is not None
        return identified(self.data, past, *own, windowed, triangle=self.triangle)

    @cached_property
    def rows(self) -> Floats:
        """The rows (z, outcomes) that the model is of, (N, d + n_outputs)."""
        return rows_of(self.regressors, self.data, self.first)[1]

    @property
    def n(self) -> int:
        """The number of states."""
        return len(self.state_names)

    @property
    def m(self) -> int:
        """The number of inputs."""
        return self.data.m

    @property
    def dt(self) -> float | None:
        """The time between two steps [s]; None if unspecified."""
        return self.data.dt

    @property
    def size(self) -> int:
        """The number of pairs N; of outputs, those with a complete window."""
        return self.core.size

    @property
    def state_names(self) -> tuple[str, ...]:
        """The names of the states; of outputs, those of the contents of the window."""
        return self.data.state_names if self.window is None else self.window.state_names

    @property
    def outputs(self) -> tuple[str, ...]:
        """The names of what is predicted: the outputs, or the states where all are measured."""
        return self.data.state_names

    @property
    def n_outputs(self) -> int:
        """The number of outputs."""
        return self.data.n

    @property
    def input_names(self) -> tuple[str, ...]:
        """The names of the inputs."""
        return self.data.input_names

    @property
    def design(self) -> str:
        """The declared design."""
        return self.assumptions.design

    @property
    def noise(self) -> str:
        """The declared law of the noise."""
        return self.assumptions.noise

    @property
    def _d(self) -> int:
        return self.regressors.length

    @property
    def _free(self) -> int:
        """How many regressors there are behind the first n_outputs, without the 1."""
        return self._d - self.n_outputs - self.intercept

    @cached_property
    def estimate(self) -> _core.Estimate:
        """The estimate from all rows, without a pilot."""
        return self.core.estimate

    @cached_property
    def parts(self) -> list[_core.Estimate] | None:
        """The estimates from the first pairs, which say the size of the others, and from these."""
        return self.core.parts

    @property
    def _first(self) -> int:
        """How many of the first pairs say the size of the others; 0 where none is asked for."""
        return self.parts[0].size if self.parts else 0

    @cached_property
    def Theta(self) -> Floats:
        """``[A B c]``, read-only."""
        return self.coefficients if self.window is None else validation.frozen(self.loop.ABc)

    @cached_property
    def loop(self) -> Loop:
        """The linear system of the contents of the window."""
        return self.regressors.loop(self.coefficients)

    @property
    def with_outputs(self) -> tuple[Floats, Floats]:
        """A and the covariance of the noise, of outputs in front of the window if there is one."""
        covariance = self.covariance
        assert covariance is not None
        if self.window is None:
            return self.A, covariance
        (J, _, G), n, p = self.loop, self.n, self.n_outputs
        ahead = (self.coefficients @ J)[:, :n]
        A = np.block([[np.zeros((p, p)), ahead], [np.zeros((n, p)), self.A]])
        both = np.vstack([np.eye(p), G])
        return A, both @ covariance @ both.T

    @cached_property
    def coefficients(self) -> Floats:
        """The coefficients of z that were estimated, (n_outputs, d), read-only."""
        made = self.estimate.Theta if self.pilot is None else self.piloted.centre
        return validation.frozen(made)

    @cached_property
    def of_any_design(self) -> Model | None:
        """Least squares of the pairs of a model by a pilot; None for a singular covariance."""
        known = self.assumptions.known
        if known is not None and least_correlation(known) <= 1e-12:
            return None
        return replace(self, pilot=None)

    @cached_property
    def piloted(self) -> _core.Pilot:
        """The runs as the pilot simulates them."""
        pilot: Any = self.pilot
        return pilot.simulated(self.data, self.rows, self._free)  # type: ignore[no-any-return]

    @cached_property
    def reference(self) -> _core.Reference:
        """The reference of the pilot, with what the bounds near it need."""
        pilot: Any = self.pilot
        return self.piloted.reference(pilot.start, np.ascontiguousarray(pilot.inputs))

    @property
    def level(self) -> float:
        """What plans take without a probability of error."""
        return DELTA if self.looks is None else self.looks

    @property
    def covariance(self) -> Floats | None:
        """The covariance of the noise, shape (n, n): the known one, or ``S / nu`` of the residuals.

        None if there are no more pairs than unknowns.
        """
        if self.assumptions.known is not None:
            return self.assumptions.known
        return self.estimate.covariance

    @property
    def _coefficients(self) -> tuple[tuple[str, ...], tuple[str, ...], Floats]:
        return self.outputs, self.regressors.regressor_names, self.coefficients

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to be careful about, one sentence each; see also `checks`."""
        accepted = self.assumptions.accept
        said = [*self.doubts]
        said += [f"accepted: {text}" for name, text in self._faults.items() if name in accepted]
        large = self._tested.get("noise too large")
        if large is not None and large.p_value <= tests.FAULT and large.share < 0.9:
            said.append(
                f"the residuals are {show.two(large.share)} of the declared noise: bounds are "
                "larger than needed"
            )
        if self.checks is not None:
            said += self.checks.warnings
        elif tests.too_many(self.size, self.n_outputs):
            said.append(
                f"the residuals were not tested, as {self.size} pairs take long: see Model.check"
            )
        said += cautions(self.blocks, self.missing)
        if self.parts and self.parts[0].rank < self.rank:
            said.append(
                f"the first {self._first} pairs do not determine what later ones do, so that "
                "regions are infinite: pass `scale`"
            )
        if self.pilot is not None and not self.piloted.determined:
            said.append("the runs that the pilot simulates do not determine the model")
        return tuple(said)

    @cached_property
    def doubts(self) -> tuple[str, ...]:
        """Why no certificate of a plan from this model is finite, one sentence each.

        Columns that are tied exactly, which `identify` was not told, and tests of the log that
        fail and were not accepted by name: each has a level of 5e-4, so that together they refuse
        less than 1 % of sound logs. Empty where nothing is seen, which proves nothing.
        """
        exact = tests.exact_relations(
            self.core.plain, self._tested_rows, self.outputs, not self.data.outputs
        )
        return (*exact, *self._refusing)

    @property
    def _refusing(self) -> tuple[str, ...]:
        """The tests that fail and are not taken, in words."""
        accepted = self.assumptions.accept
        return tuple(text for name, text in self._faults.items() if name not in accepted)

    @property
    def tests(self) -> dict[str, float]:
        """The p-value of each test of the log that the pairs allow, by its name in `accept`."""
        return {name: self._tested[name].p_value for name in FAULTS if name in self._tested}

    @cached_property
    def _tested(self) -> dict[str, Tested]:
        return tests.by_name(self.core.tests)

    @property
    def _tested_rows(self) -> list[int]:
        return tests.tested_rows(self.assumptions, self.known, self.n_outputs)

    @cached_property
    def _faults(self) -> dict[str, str]:
        """The tests that fail, in words."""
        return {
            name: tests.sentence(name, self._tested[name], self)
            for name in tests.failed(self._tested, self.assumptions)
        }

    def check(self, draws: int = 499, *, rng: RngLike = None) -> Checks | None:
        """Test the residuals again, with another number of simulated data sets.

        Parameters
        ----------
        draws : int, default 499
            Their number.
        rng : None, int, SeedSequence, Generator, BitGenerator or Key, optional
            Source of randomness.

        Returns
        -------
        Checks or None
            None with too few pairs.

        Raises
        ------
        InputError, InputTypeError
            If `draws` is not a whole number > 0.
        SeedError
            If `rng` cannot be used.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> z = np.random.default_rng(1).standard_normal((40, 3))
        >>> data = se.Trajectories.from_pairs(z[:, :1], z[:, 1:2], z[:, :1] + z[:, 2:])
        >>> se.identify(data).check(99, rng=1).draws
        99
        """
        count, key = validation.size("draws", draws), bytes(as_key(rng))
        about = self._d, self._tested_rows, count, key, get_num_threads()
        found = _core.residual_checks(self.rows, *about)
        return tests.checks_of(found, count, self.design)

    def plot(self, *, figure: Figure | SubFigure | None = None) -> Figure:
        """Draw what the checks look at: residuals over time, lags, quantiles and leverages.

        Parameters
        ----------
        figure : matplotlib Figure or SubFigure, optional
            Where to draw; the default is a new figure.

        Returns
        -------
        matplotlib Figure
            Four panels, with the p-values of `checks`.

        Raises
        ------
        ImportError
            If matplotlib is not installed.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> z = np.random.default_rng(1).standard_normal((40, 3))
        >>> data = se.Trajectories.from_pairs(z[:, :1], z[:, 1:2], z[:, :1] + z[:, 2:])
        >>> len(se.identify(data).plot().axes)
        4
        """
        Z, Y = np.hsplit(self.rows, [self._d])
        residuals = Y - Z @ self.coefficients.T
        # h_t = ||z_t||^2 in the norm of V^-1, over the columns of all rows of Theta together
        leverages = np.sum((Z @ self.core.plain.white.T) ** 2, axis=1)
        tested = None if self.checks is None else self.checks.p_values
        return draw_residuals(residuals, leverages, self.outputs, tested, figure)

    def region(
        self,
        delta: float = 0.05,
        *,
        components: bool = False,
        x0: ArrayLike | None = None,
        directions: ArrayLike | None = None,
        future: int = 0,
        frobenius: bool = False,
        method: Method = "auto",
        anytime: bool = False,
    ) -> Region:
        """Return a set of models that contains the true one.

        Parameters
        ----------
        delta : float, default 0.05
            The probability that it does not, in (0, 1).
        components : bool, default False
            One region for each row of ``[A B c]`` instead of one for all: sharper for every
            component of a step, wider for its norm.
        x0 : array_like, shape (n,), optional
            A state that was fixed before the data; the region then bounds steps from this state
            only, with any input, and is smaller.
        directions : array_like, shape (n + m, r), optional
            The same for all ``z = (x, u)`` in the span of these columns, which must have been fixed
            without a look at the outcomes ``x_next``; with intercept ``(x, u, 1)``.
        future : int, default 0
            Let the noise of this many steps to come be covered too, in the same event.
        frobenius : bool, default False
            Bound the Frobenius norm as well, in the same event, as errors over several steps need.
        method : {"auto", "mixture", "universal"}, default "auto"
            For Gaussian noise of unknown covariance with any design. "mixture": small, but infinite
            with few pairs. "universal": finite once there are n more pairs than unknowns, wide, and
            valid for all N at once. "auto": the smaller of both, each with delta / 2.
        anytime : bool, default False
            For any design: whether the region is to hold for all N at once, so that it may be asked
            for again and again while data arrive. It is then made with `scale`, or 1, and not with
            the first pairs. For known noise it does so with a `scale` in any case.

        Returns
        -------
        Region
            With its assumption in words.

        Raises
        ------
        InputError, InputTypeError
            If no region is known for what was assumed, or an argument cannot be used.

        Notes
        -----
        ``H`` is least squares, ``D = H - Theta``, ``V = sum z z'``, S the residual sum of squares,
        ``nu = N - rank``. Independent design, Gaussian noise: ``D V D' <= q S`` with the exact
        quantile q of the largest root of ``E^-1 G G'`` (Roy 1953; Chiani 2016), and its relatives
        for diagonal, scalar and known covariance. Any design: ``||W Z' V_lam^-1/2||^2 <= 2 sigma^2
        c`` for all N at once, with ``1F1(1/2; n/2; c) = det(I + V/lam)^(1/2) / delta``, a mixture
        over lines in the manner of Abbasi-Yadkori, Pal and Szepesvari (2011), without a bound on
        Theta. Without `scale`, ``kappa P`` takes the place of ``lam I``, with ``P = sum z z' / N1``
        of the N1 first pairs and kappa 1/6, 1/3 and 2/3 of the number of those after them, of which
        H, V and S are then; the `centre` is their H.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> z = np.random.default_rng(2).standard_normal((40, 5))
        >>> x, u, w = z[:, :2], z[:, 2:3], 0.1 * z[:, 3:]
        >>> data = se.Trajectories.from_pairs(x, u, 0.5 * x + u + w)
        >>> model = se.identify(data, noise=se.Noise(sigma=0.1, design="independent"))
        >>> region = model.region(0.05)
        >>> region.contains([[0.5, 0.0], [0.0, 0.5]], [[1.0], [1.0]])
        True
        >>> region.assumption
        'Gaussian noise of known covariance, independent of all states and inputs'
        """
        wish = Wish(
            validation.probability("delta", delta),
            validation.flag("components", components),
            spanned_by(self._d, self.n_outputs, self._free, x0, directions),
            validation.size("future", future, minimum=0, maximum=10_000),
            validation.flag("frobenius", frobenius),
            validation.choice("method", method, METHODS),
            validation.flag("anytime", anytime),
        )
        return withheld(asked_region(self, wish), self._refusing)

    def draw(self, size: int, *, rng: RngLike = None) -> SystemEnsemble:
        """Draw models from the law that the region is made of.

        Parameters
        ----------
        size : int
            The number of models.
        rng : None, int, SeedSequence, Generator, BitGenerator or Key, optional
            Source of randomness.

        Returns
        -------
        SystemEnsemble
            ``H + S^1/2 E^-1/2 G V^-1/2``, E ~ W_n(I, nu), G standard normal; for a known
            covariance ``H + Sigma^1/2 G V^-1/2``; with a pilot, T of its instruments in place of
            ``V^-1/2``. With mean H: ``centre`` is "estimate".

        Raises
        ------
        InputError, InputTypeError
            If the data do not determine the model, single entries were declared as known, the noise
            is not Gaussian, or there are too few pairs.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> z = np.random.default_rng(1).standard_normal((40, 3))
        >>> data = se.Trajectories.from_pairs(z[:, :1], z[:, 1:2], z[:, :1] + z[:, 2:])
        >>> se.identify(data).draw(100, rng=1)
        <SystemEnsemble: 100 models, n=1 m=1, about the estimate>
        """
        count = validation.size("size", size)
        law, key = estimate_law(self), as_key(rng).child("draw")
        running.need("the models", 3 * 8 * count * self.Theta.size)
        found = _core.estimate_draws(law, count, bytes(key), get_num_threads())
        A, B, c = np.split(found.reshape(count, *self.Theta.shape), [self.n, self.n + self.m], 2)
        return SystemEnsemble(
            A,
            B,
            c[:, :, 0] if self.intercept else None,
            centre="estimate",
            dt=self.dt,
            labels=self.labels if self.labels.given else None,
            about="draws of the law of the estimate",
        )

    def accepts(
        self, runs: Trajectories, *, level: float = 0.05, design: Design = "adaptive"
    ) -> Changes:
        """Test whether new runs are of the plant that the model is of; exact for any number.

        Parameters
        ----------
        runs : Trajectories
            New runs, with the same names; they had no part in the model.
        level : float, default 0.05
            A model of the same plant is refuted with at most this probability: half of it is for
            the region of the model, half for the new runs.
        design : {"adaptive", "independent"}, default "adaptive"
            "independent": the states and inputs of the pairs depend neither on their noise nor on
            outcomes in the data of the model, as in open loop. Then the test is exact, for a model
            that is of this design, too, with Gaussian noise of unknown covariance. Else any
            feedback is allowed.

        Returns
        -------
        Changes
            "refuted" is proved. "not refuted" does not confirm the model: ``detectable`` says what
            change would have been found.

        Raises
        ------
        InputError, InputTypeError
            If the names differ, the model has no region or no bound of its noise, or the design
            does not fit.

        Notes
        -----
        ``|l' (H - Theta) q|`` of the new pairs is within ``sqrt(l' S l) r(q)`` for all l, q and
        lengths at once (mixtures of supermartingales, Abbasi-Yadkori et al. 2011, with directions
        on the sphere); what the region allows is added. In open loop ``lmax((S1 + S2)^-1 D K^-1
        D')`` has Roy's law, D the difference of both estimates.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 200, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 0.5 * x + u + w)
        >>> model = se.identify(data, noise=1.0)
        >>> x, u, w = np.random.default_rng(2).standard_normal((3, 200, 1))
        >>> model.accepts(se.Trajectories.from_pairs(x, u, 0.5 * x + 0.1 * u + w)).explanations
        ('u[0]', 'x[0](k+1)')
        """
        return accepted(self, validation.instance("runs", runs, Trajectories), level, design)

    def excitation(self) -> tuple[str, ...]:
        """Which effects the data do not determine, one sentence each; empty if all are.

        Returns
        -------
        tuple of str
            By the names of the regressors: what never moved, or only together, and effects whose
            sign is not determined at 95 %.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 100, 1))
        >>> runs = se.Trajectories.from_pairs(x, 0.01 * u, 0.5 * x + 0.01 * u + 0.1 * w)
        >>> se.identify(runs, noise=0.1).excitation()
        ('u[0]: little excited, the sign of its effect is not determined',)
        """
        return unexcited(self)

    @cached_property
    def largest(self) -> Floats | None:
        """The largest size of each state and input in the data; None for a window."""
        past = self.data.rows[:, : self.data.n + self.m]
        return None if self.window is not None else np.abs(past).max(axis=0)

    def _verify(self) -> None:
        """Refuse a triangle that is not that of the data."""
        running.need("the pairs", 3 * self.data.rows.nbytes)
        require_triangle_of(self.rows, self.triangle)

    def __repr__(self) -> str:
        sizes = f"n={self.n} m={self.m}"
        if self.window is not None:
            sizes = f"outputs={self.n_outputs} m={self.m}, {self.window.text}"
        return self._text(sizes)

    def _repr_html_(self) -> str:
        checks = "not tested" if self.checks is None else repr(self.checks)[1:-1]
        rows = [("assumed", said(self.assumptions, None, self._first)), ("residuals", checks)]
        return show.card(self, rows, self._table())


Past: TypeAlias = tuple[_core.Window, int] | tuple[float, int] | int


def identified(
    data: Trajectories,
    past: Past,
    assumed: Assumptions,
    scaled: bool,
    offset: bool,
    known: Floats | None,
    piloted: bool,
    windowed: bool,
    delays: tuple[int, int] = (0, 0),
    **about: Any,
) -> _core.Identified:
    """What the core finds in the runs of a model.

    `past` is a window with the number of pairs before its model, filters, lags, or whether filters
    are tried beside lags.
    """
    if windowed:
        kind, count = past if isinstance(past, tuple) else (0.0, past)
        length = kind.length if isinstance(kind, _core.Window) else count * (data.n + data.m)
        running.need("the pairs", 8 * data.size * (length + data.n))
    log, all_of = (data.rows, data.layout), data.whole
    whole = None if all_of is None else (all_of.rows, all_of.layout)
    exact = assumed.design == "independent" and assumed.noise == "gaussian"
    flags = offset, bool(data.outputs), windowed, scaled, exact, piloted
    of = known, tests.tested_rows(assumed, known, data.n), assumed.declared, get_num_threads()
    return _core.identify(log, whole, (data.n, data.m), past, (delays, flags), *of, **about)


def require_states(model: Model, name: str) -> None:
    """Refuse a model of outputs where an argument must be one of states."""
    if model.window is not None:
        raise InputError(f"`{name}` must be a model of states, got one of outputs: {model!r}")


def in_states(model: Identified, region: Region) -> Region:
    """A region of a model by the states of its window."""
    if model.window is None:
        return region
    J, ABc, G = model.window.loop(region.centre)
    return entered(region, ABc, J, G, len(model.input_names))


def after(model: Model, size: int) -> Model:
    """The model with so many pairs, if data go on like those so far; with all else as it is."""
    later, times = object.__new__(Model), size / model.size
    vars(later).update({k: v for k, v in vars(model).items() if k not in ("blocks", "missing")})
    vars(later)["estimate"] = model.estimate.after(size, times)
    if model.parts:
        before, own = model.parts
        vars(later)["parts"] = before, own.after(ceil(own.size * times), times)
    return later


def asked_region(model: Model, wish: Wish) -> Region:
    """The region whatever the tests of the log say; of a stream it holds at all looks."""
    if model.looks is not None:
        if wish.delta > model.looks:
            raise InputError(
                f"`delta` must be at most {model.looks:g}, which all looks share, got "
                f"{wish.delta:g}"
            )
        wish = wish._replace(anytime=True)
    refuse_region(model.assumptions, wish, len(model.blocks) > 1)
    first = 0 if wish.anytime else model._first
    assumption, missing = said(model.assumptions, wish, first), model.missing
    if model.pilot is not None:
        if wish != Wish(wish.delta, frobenius=wish.frobenius):
            raise InputError("a region by a pilot takes `delta` and `frobenius` only")
        law = model.assumptions.covariance, model.assumptions.known
        made = model.piloted.region(law, wish.delta, wish.frobenius)
        assumption = f"{model.assumptions.text}, {model.pilot.said}"
    else:
        scale = np.ones(model._d) if model.scale is None else np.ascontiguousarray(model.scale)
        units, estimate = model.parts if model.parts and first else (scale, model.estimate)
        made = region_of(estimate, model.assumptions, wish, units)
        missing = model._missing_in(estimate)
    assumption += "" if model.window is None else assumed(model.window, model.assumptions.tail)
    assumption += "" if model.misfit is None else f", {model.misfit.text}"
    accepted = ", ".join(model.assumptions.accept)
    assumption += model.data.assumption + (f"; accepted by name: {accepted}" if accepted else "")
    found = of_core(made, model.assumptions, wish, model._free, assumption, missing)
    return found if model.misfit is None else with_misfit(model, model.misfit, found, wish)


def with_misfit(model: Model, misfit: Misfit, region: Region, wish: Wish) -> Region:
    """The region of the linear part, grown by what the misfit did to the data."""
    if wish != Wish(wish.delta):
        raise InputError(
            "a model with a misfit has certificates of a feedback only; its region takes `delta`"
        )
    z = model.rows[model._first :, : model._d]
    part = grown(misfit, region.parts[0], z, model.labels)
    return region._but(parts=(part,), frobenius=None, misfit=misfit)


def require_fit(
    misfit: Misfit, data: Trajectories, assumed: Assumptions, scale: Floats | None, beside: Any
) -> None:
    """Refuse a misfit for which no region is known, or names that are not those of the data."""
    block_of(misfit, Labels(data.state_names, data.input_names))
    if assumed.known is None or assumed.exact or assumed.tail or any(x is not None for x in beside):
        raise InputError(
            "`misfit` needs noise=sigma, without exact states, known entries, window, tail or pilot"
        )
    if misfit.limit < np.inf and scale is None:
        raise InputError(
            "`misfit` leaves out pairs, so that their number is not fixed beforehand: pass `scale`"
        )


def estimate_law(model: Model, windows: bool = False) -> tuple[Floats, Floats, Floats, str, int]:
    """The law of the estimate, for the core; only with `windows` also of models of outputs."""
    if model.looks is not None:
        raise InputError("the law of an estimate needs a number of pairs that was fixed beforehand")
    white = white_of(model, windows)
    if model.noise != "gaussian":
        raise InputError(f"draw() needs Gaussian noise, got '{model.noise}'")
    fitted, noise = model.blocks[0], model.assumptions
    least = model.n_outputs if noise.covariance == "full" else 1
    if noise.known is None and fitted.nu < least:
        raise InputError(f"draw() needs at least {fitted.rank + least} pairs, got {fitted.N}")
    S = fitted.S if noise.known is None else noise.known
    return model.coefficients, white, S, noise.covariance, fitted.nu


def white_of(model: Model, windows: bool = False) -> Floats:
    """``white' white = V^-1`` of all columns, where the rows of Theta have one V."""
    if model.misfit is not None:
        raise InputError("models with a misfit are not resampled: see region()")
    if model.window is not None and not windows:
        raise InputError("models of outputs are not resampled: see region()")
    if not model.identifiable:
        raise InputError(f"the data do not determine the model along {'; '.join(model.missing)}")
    if model.pilot is not None and not model.piloted.determined:
        raise InputError("the runs that the pilot simulates do not determine the model")
    if len(model.blocks) > 1:
        raise InputError("the rows of a model with single known entries have no V in common")
    if model.pilot is not None:
        return model.piloted.white
    fitted = model.blocks[0]
    white = np.zeros((fitted.rank, model._d))  # 0 in columns that are known
    white[:, fitted.columns] = fitted.white
    return white
