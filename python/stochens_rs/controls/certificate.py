"""How far the true system can end from its target: the record of a bound from data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from .._base import html, validation
from .._base.records import SavedRecord
from ..exceptions import InputError, ShapeError

if TYPE_CHECKING:
    from .._base.types import Floats


@dataclass(frozen=True, eq=False, repr=False)
class Certificate(SavedRecord):
    """Bounds on where the true system ends under a control that was computed from data.

    Made by `Plan.bound` for a plan whose system is a model from data.

    Attributes
    ----------
    target : float
        ``||x(K) - xf||`` is at most this: ``reach + model_error + start``. Infinite where the data
        do not determine where the control leads; `missing` then names the directions.
    state : float
        The same for the distance of x(K) from the last of the plan's ``predicted_states``.
    reach : float
        ``||xh(K) - xf||``: how far the model itself ends from xf.
    model_error : float
        What the error of the model adds, and with `noise` the noise of the run to come.
    start : float
        What an uncertain x0 adds.
    components : ndarray, shape (n,)
        ``|x(K) - xf|_i`` is at most this, for all i at once. For one step without noise a statement
        of its own, by a sharper region for each row, and with Gaussian noise of bounded covariance
        by a quantile for each component, with probability ``1 - delta``; else in the same event as
        `target`.
    tube : ndarray, shape (K + 1,)
        ``||x(k) - xh(k)||`` is at most this, for all k at once, around ``predicted_states``.
    control : float
        ``||u - v||`` is at most this, v the exact best control; infinite where it is not known.
    control_reason : str or None
        Why `control` is infinite.
    control_method : str or None
        What gave `control`: "the region"; with limits "how far the best control moves in the
        region", or "the limits alone" where no control within them is further away. None where it
        is infinite.
    delta : float
        `target`, `state`, `tube` and `control` hold together with probability ``1 - delta``.
    assumption : str
        What that rests on, in words.
    method : str
        "one step", "several steps" or "direct regression over K steps": what gave `target`.
    noise : bool
        Whether the noise of the run to come is included.
    excess : float or None
        With limits: ``J(u) - J(v)`` is at most this, in the same event; `control` then compares
        with the best control v of the true system within the limits.
    apart : float or None
        With limits: bound on ``(sum_k ||x(k) - y(k)||_{Q_k}^2)^(1/2)``, x and y the states of the
        true system under u and v.
    missing : tuple of str
        The directions that the data do not determine, where `target` is infinite.
    doubts : tuple of str
        Why nothing is certified: columns of the data that are no states of a plant, unless they
        are declared, see `Model.doubts`.
    warnings : tuple of str
        What to be careful about: the warnings of the model.
    """

    target: float
    state: float
    reach: float
    model_error: float
    start: float
    components: Floats
    tube: Floats
    control: float
    control_reason: str | None
    delta: float
    assumption: str
    method: str
    noise: bool
    missing: tuple[str, ...] = ()
    excess: float | None = None
    apart: float | None = None
    control_method: str | None = None
    doubts: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        validation.probability("delta", self.delta)
        validation.flag("noise", self.noise)
        if self.doubts and np.isfinite(self.target):
            raise InputError("`target` must be infinite where there are `doubts`")
        for name in ("components", "tube"):
            if np.ndim(getattr(self, name)) != 1:  # entries may be infinite
                raise ShapeError(f"`{name}` must have one dimension")

    @property
    def larger(self) -> Literal["model error", "reachability"]:
        """The larger part of `target`: more data help, or more steps and inputs."""
        return "reachability" if self.reach > self.model_error + self.start else "model error"

    @property
    def _share(self) -> str:
        return f"{100 * (1 - self.delta):.6g} %"

    @property
    def _run(self) -> str:
        return "with noise" if self.noise else "without noise"

    def __repr__(self) -> str:
        if np.isfinite(self.target):
            what = f"within {self.target:.3g} of xf, mostly {self.larger}"
        elif self.doubts:
            what = f"nothing is certified: {self.doubts[0]}"
        elif self.missing:
            some = ", ".join(self.missing[:3])
            what = f"unbounded: the data do not determine the system along {some}"
        else:
            what = "unbounded: too few data, weak instruments, or too many steps"
        careful = html.warned([text for text in self.warnings if text not in self.doubts])
        return f"<Certificate: {what}, {self._share}, {self.method} {self._run}{careful}>"

    def _repr_html_(self) -> str:
        control = self.control_reason or (
            f"within {self.control:.4g} of the exact best one, by {self.control_method}"
        )
        rows = [
            ("last state", f"within {self.state:.4g} of the predicted one"),
            ("model ends off xf by", self.reach),
            ("error of the model", self.model_error),
            ("uncertain start", self.start or None),
            ("components of x(K) - xf", html.vector(self.components)),
            ("control", control),
            ("more than the least J", self.excess),
            ("holds with", f"{self._share} at least"),
            ("for", self.assumption),
            ("not determined", "; ".join(self.missing) or None),
            *(("nothing is certified", text) for text in self.doubts),
            *(("warning", text) for text in self.warnings if text not in self.doubts),
        ]
        drawn = html.states(
            np.arange(len(self.tube)), self.tube[:, None], "radius around the predicted states"
        )
        return html.card(self, rows, drawn)
