"""`Model`: least squares of measured data, and the regions and ensembles that follow."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .._base import gate, html, memory
from .._base.durable import Durable, nothing_left
from .._base.tabled import Cube, Tabled
from ..plots.residuals import draw_residuals
from ..rng import RngLike, as_key
from .certifying import METHODS, Method, Wish, parts, refuse, said, sign_region
from .certifying import directions as spanned
from .checks import Checks, checked_residuals
from .consistency import require_triangle_of
from .dependences import tested_rows
from .files import Sections, from_model, to_model
from .instruments import instrumented, projected
from .least_squares import fit, r_factor
from .region import Region
from .resampling import Resampled
from .trajectories import Trajectories

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure
    from numpy.typing import ArrayLike


class Model(Durable, Tabled, Resampled):
    """A model ``x(k+1) = A x(k) + B u(k) + c`` identified from data, with what was assumed.

    Made by `identify`.

    Attributes
    ----------
    data : Trajectories
        The pairs it was fitted to: with instruments, every second pair of each run.
    triangle : ndarray
        R with ``R' R = W' W`` for the rows ``W = (x, u, 1, x_next)`` of all pairs, with the
        instruments before them if there are any: all that the estimate and most regions need.
    assumptions : Assumptions
        Design, noise, covariance, state noise and exact states, as declared.
    scale : ndarray, shape (n + m,) or (n + m + 1,)
        The sizes of states and inputs that were expected before the data.
    intercept : bool
        Whether there is an offset c.
    known : ndarray, shape (n, n + m) or (n, n + m + 1), or None
        The entries that were declared as known; nan where an entry was estimated.
    instruments : ndarray, shape (N, r), or None
        The instruments of the pairs of `data`.
    checks : Checks or None
        The tests of the residuals; None if there were too few pairs, too many to test them
        without being asked, or `identify` was told not to: see `check`.
    key : Key or None
        That of the sign vectors, for noise of symmetric law.
    """

    _kind = "model"

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

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> z = np.random.default_rng(1).standard_normal((40, 3))
        >>> data = se.Trajectories.from_pairs(z[:, :1], z[:, 1:2], z[:, :1] + z[:, 2:])
        >>> se.identify(data).check(99, rng=1).draws
        99
        """
        count, key = gate.size("draws", draws), as_key(rng)
        rows = tested_rows(self.assumptions, self.known, self.n)
        exact = self.design == "independent"
        return checked_residuals(*self._pairs(), rows, exact=exact, draws=count, key=key)

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
        Z, Y = self._pairs()
        residuals = Y - Z @ self._Theta.T
        # h_t = ||z_t||^2 in the norm of V^-1, over the columns of all rows of Theta together
        white = fit(r_factor(self._own), self._d, self.size).white
        leverages = np.sum((Z @ white.T) ** 2, axis=1)
        tested = None if self.checks is None else self.checks.p_values
        return draw_residuals(residuals, leverages, self.state_names, tested, figure)

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
            For the same case: whether the region is to hold for all N at once, so that it may be
            asked for again and again while data arrive. For known noise it does in any case.

        Returns
        -------
        Region
            With its assumption in words.

        Raises
        ------
        InputError, InputTypeError
            If no region is known for what was assumed; no model explains the data (instruments);
            or an argument cannot be used.

        Notes
        -----
        ``H`` is least squares, ``D = H - Theta``, ``V = sum z z'``, S the residual sum of squares,
        ``nu = N - rank``. Independent design, Gaussian noise: ``D V D' <= q S`` with the exact
        quantile q of the largest root of ``E^-1 G G'`` (Roy 1953; Chiani 2016), and its relatives
        for diagonal, scalar and known covariance. Any design: ``||W Z' V_lam^-1/2||^2 <= 2 sigma^2
        c`` for all N at once, with ``1F1(1/2; n/2; c) = det(I + V/lam)^(1/2) / delta``, a mixture
        over lines in the manner of Abbasi-Yadkori, Pal and Szepesvari (2011), without a bound on
        Theta. Symmetric noise: sign-perturbed sums (Csaji, Campi and Weyer 2015). Instruments:
        Anderson and Rubin (1949).

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> z = np.random.default_rng(2).standard_normal((40, 5))
        >>> x, u, w = z[:, :2], z[:, 2:3], 0.1 * z[:, 3:]
        >>> data = se.Trajectories.from_pairs(x, u, 0.5 * x + u + w)
        >>> model = se.identify(data, design="independent", sigma=0.1)
        >>> region = model.region(0.05)
        >>> region.contains([[0.5, 0.0], [0.0, 0.5]], [[1.0], [1.0]])
        True
        >>> region.assumption
        'Gaussian noise of known covariance, independent of all states and inputs'
        """
        wish = Wish(
            gate.probability("delta", delta),
            gate.flag("components", components),
            spanned(self._d, self.n, self.m, x0, directions),
            gate.size("future", future, minimum=0, maximum=10_000),
            gate.flag("frobenius", frobenius),
            gate.choice("method", method, METHODS),
            gate.flag("anytime", anytime),
        )
        noise, by_rows = self.assumptions, len(self._blocks) > 1
        refuse(noise, wish, self.instruments is not None, by_rows)
        centre, signs, radius, text = self._Theta, None, None, ""
        covariance = None
        found = self._blocks_of(by_rows=True) if wish.components and not by_rows else self._blocks
        if self.instruments is not None:
            source = projected(self.triangle, self.instruments.shape[1], self.size)
            centre, part = instrumented(source, self._d, wish.delta)
            made: tuple[Any, ...] = (part,)
        elif self.key is not None:
            made, signs, text = sign_region(found[0], centre, *self._pairs(), wish.delta, self.key)
            radius = made[0].radius
        else:
            made, radius, covariance = parts(found, noise, wish, self.scale, self.n)
        return Region._computed(
            centre=gate.frozen(centre),
            m=self.m,
            delta=wish.delta,
            assumption=said(noise, wish, self.instruments is not None) + text,
            missing=self.missing if self.instruments is None else (),
            parts=made,
            future=wish.future,
            frobenius=radius,
            signs=signs,
            noise=None if covariance is None else gate.frozen(covariance),
        )

    def _cube(self) -> Cube:
        variables = {
            "A": (("state", "from_state"), self.A, None),
            "B": (("state", "input"), self.B, None),
            "c": (("state",), self.c, "state"),
            "covariance": (("state", "other_state"), self.covariance, None),
        }
        attrs = {
            "dt": self.dt,
            "size": self.size,
            "design": self.design,
            "noise": self.noise,
            "key": None if self.key is None else self.key.hex,
        }
        return Cube(variables, {}, attrs, self.labels)

    def _to_sections(self) -> Sections:
        return from_model(self)

    @classmethod
    def _from_sections(cls, sections: Sections) -> Model:
        (rows, *about), fields = to_model(sections)
        nothing_left(sections)
        model = cls(Trajectories._of(gate.matrix("rows", rows), *about), **fields)
        model._verify()
        return model

    def _verify(self) -> None:
        """Refuse a triangle that is not that of the data."""
        memory.need("the pairs", 3 * self.data._rows.nbytes)
        zeta = () if self.instruments is None else (self.instruments,)
        require_triangle_of(np.hstack([*zeta, *self._pairs()]), self.triangle)

    def __repr__(self) -> str:
        rank = "" if self.identifiable else f", rank {self.rank} of {self._d}"
        dt = "" if self.dt is None else f" dt={self.dt:g}"
        over = "" if self.data.steps == 1 else f" over {self.data.steps} steps"
        pairs = html.number_of(self.size, "pair")
        return (
            f"<Model: n={self.n} m={self.m}{dt}{over}, {pairs}, {self.design} design{rank}"
            f"{html.warned(self.warnings)}>"
        )

    def _repr_html_(self) -> str:
        checks = "not tested" if self.checks is None else repr(self.checks)[1:-1]
        rows = [
            ("assumed", said(self.assumptions, None, self.instruments is not None)),
            ("residuals", checks),
            *(("warning", text) for text in self.warnings),
        ]
        return html.card(self, rows, self._table())
