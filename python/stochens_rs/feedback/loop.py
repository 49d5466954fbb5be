"""`Loop`: a linear feedback, its cost, and what it was made for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

import numpy as np

from .. import _core
from .._base import html, validation
from .._base.records import SavedRecord
from .._base.signal_names import Labels
from ..exceptions import InputError, NonFiniteError
from ..identification.identified import Identified
from ..identification.model import Model
from ..identification.region import Region
from .certificate import LoopCertificate

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from .._base.types import Floats

GainMethod: TypeAlias = Literal["least squares", "guaranteed cost", "widest margin"]


@dataclass(frozen=True, eq=False, repr=False)
class Loop(SavedRecord):
    """A linear feedback ``u = K x``.

    Made by `gain`; call it with a state for the input.

    Attributes
    ----------
    A : ndarray, shape (n, n)
        The state matrix of the system, or of the centre of the model.
    B : ndarray, shape (n, m)
        Its input matrix.
    K : ndarray, shape (m, n)
        The gain: ``u = K x``.
    S : ndarray, shape (n, n), or None
        ``x'Sx`` is the cost ``sum_k x(k)'Qx(k) + u(k)'Ru(k)`` from ``x(0) = x``; with a guarantee
        a bound of it for all systems of the region. None without weights.
    method : {"least squares", "guaranteed cost", "widest margin"}
        What K minimises.
    parameter : float or None
        With a guarantee the multiplier of the proof; for the widest margin how many times larger
        the region may be at most, 0 where nothing was proved. Else None.
    labels : Labels
        The names of states and inputs.
    dt : float or None
        The time between two steps [s].
    model : Model, FusedModel or None
        The model from data it was made for.
    """

    A: Annotated[Floats, "state state"]
    B: Annotated[Floats, "state input"]
    K: Annotated[Floats, "input state"]
    S: Annotated[Floats, "state state"] | None
    method: GainMethod
    parameter: float | None
    labels: Labels
    dt: float | None = None
    model: Identified | None = None

    @property
    def E(self) -> NDArray[np.complex128]:
        """The eigenvalues of ``A + B K``, shape (n,)."""
        return _core.loop_eigenvalues(self.A, self.B, self.K)

    def __call__(self, x: ArrayLike) -> Floats:
        """Return ``u = K x``, shape (m,), for a state x, shape (n,); what is not finite raises."""
        state = validation.measured("x", x, self.labels.states)
        with np.errstate(all="ignore"):
            u = np.asarray(self.K @ state)
        if not np.isfinite(u).all():
            why = validation.broken(state, np.inf, self.labels.states)
            raise NonFiniteError(f"`x` must be finite: {why or 'K x overflows'}")
        return u

    def certificate(self, delta: float | Region = 0.05) -> LoopCertificate:
        """Say whether all systems of a region are stable under ``u = K x``.

        Parameters
        ----------
        delta : float or Region, default 0.05
            The probability that the true system is not in the region of the model; or a region of
            it, which may have been made with other options.

        Returns
        -------
        LoopCertificate
            The verdict with its proof or a counterexample. All that follows, such as
            `LoopCertificate.tube`, holds in the same event.

        Raises
        ------
        InputError, InputTypeError
            If there is no model from data, or it has no region.

        Notes
        -----
        With ``Theta = C + D G W``, ``||G|| <= rho``, all loops ``A0 + D G E`` have one quadratic
        Lyapunov function exactly if ``rho g < 1``, ``g = max_|z|=1 ||E (zI - A0)^-1 D||``. The
        proof is a matrix Q with ``[Q - rho^2 S, 0; 0, I] - F Q F' > 0``, ``F = [A0; E]``, checked
        with all of its rounding (Rump 2006). For regions of several parts the condition is
        sufficient only. The rounding of the least squares themselves is covered by a radius that
        is larger by 1e-8 and more for data that are nearly dependent.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 40, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 1.2 * x + u + 0.1 * w)
        >>> proof = se.gain(se.identify(data, sigma=0.1), 1.0, 1.0).certificate(0.05)
        >>> proof.status, round(proof.margin, 2)
        ('certified', 6.07)
        """
        if self.model is None:
            raise InputError("`certificate` needs a loop for a model from data: gain(model, ...)")
        region = region_of("delta", self.model, delta)
        squares = _squares(self.model) if region.noise is None else (None, 0)
        return LoopCertificate._judged(region, self.K, self.labels, self.model, squares)

    def __repr__(self) -> str:
        radius = np.abs(self.E).max()
        m, n = self.K.shape
        return f"<Loop: n={n} m={m}, {self.method}, spectral radius {radius:.4g}>"

    def _repr_html_(self) -> str:
        head = ["", *self.labels.states]
        rows = zip(self.labels.inputs, self.K, strict=True)
        table = html.grid(head, [[name, *(f"{v:.4g}" for v in row)] for name, row in rows])
        return html.card(self, [("u = K x with", "K below")], table)


def _squares(model: Identified) -> tuple[Floats | None, int]:
    """``S ~ W_n(nu, Sigma)`` of the residuals and nu, where the regressors are no part of it."""
    if not isinstance(model, Model) or model.pilot is not None:
        return None, 0
    given = model.assumptions
    if (given.noise, given.design) != ("gaussian", "independent") or len(model._blocks) > 1:
        return None, 0
    return validation.frozen(model._blocks[0].S.copy()), model._blocks[0].nu


def region_of(name: str, model: Identified, value: object) -> Region:
    """Return a region of ``[A B c]``: as given, or that of the model with this probability."""
    if not isinstance(value, Region):
        return model._in_states(model.region(validation.probability(name, value)))
    own = model.region(value.delta).centre
    if value.centre.shape != own.shape:
        raise InputError(f"`{name}` must be a region of this model, got one of another size")
    if not np.array_equal(value.centre, own):
        raise InputError(f"`{name}` must be a region of this model, got one of another centre")
    return model._in_states(value)
