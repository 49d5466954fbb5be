"""`Typical`: how far models that may be the true one miss the target, beside what is certified."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .. import _core
from .._base import show, validation
from .._base.records import Count, FromZero, Probability, SavedRecord
from .._base.running import get_num_threads
from ..certificates.of_model import ModelBasis
from ..exceptions import InputError, SizeError
from ..fusion.provenance import Basis
from ..identification.model import Model
from ..rng import as_key
from ..validation.fresh_systems import needed, rank_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from .._base.types import Floats
    from ..rng import RngLike


@dataclass(frozen=True, eq=False, repr=False)
class Typical(SavedRecord):
    """An approximate error bar of a plan from data, beside its certificate; it is no bound.

    Made by `Plan.typical` and, of means, by `DataStream.typical`.

    Attributes
    ----------
    miss : float
        A share ``1 - delta`` of the drawn models ends within this of the target.
    certified : float
        ``plan.bound(delta).target``, which does bound the distance; infinite where nothing does.
    delta : float
        The share of drawn models that miss by more.
    draws : int
        The number of drawn models.
    noise : bool
        Whether both include the noise of the run to come.
    assumption : str
        What `miss` rests on, in words.
    """

    miss: FromZero
    certified: FromZero
    delta: Probability
    draws: Count
    noise: bool
    assumption: str

    @property
    def text(self) -> str:
        """Both numbers, and what each is, in one sentence."""
        share = show.percent(self.delta)
        return (
            f"certified {show.at_most(self.certified)}, typical {self.miss:.3g}: {share} of the "
            "models drawn from the confidence distribution of the data miss by less than the "
            "second (approximate)"
        )

    def __repr__(self) -> str:
        run = "with noise" if self.noise else "without noise"
        return (
            f"<Typical: certified {show.at_most(self.certified)}, typical {self.miss:.3g}, "
            f"{show.percent(self.delta)}, {run}>"
        )

    def _repr_html_(self) -> str:
        rows = [("both", self.text), ("drawn models", self.draws), ("for", self.assumption)]
        return show.card(self, rows)


def typical(
    basis: Basis | ModelBasis | None,
    u: Floats,
    predicted: Floats,
    certified: float,
    delta: float,
    draws: int,
    rng: RngLike,
    noise: bool,
) -> Typical:
    """Check that a law of the estimate is known, and draw the misses from it.

    Without a target they are those of the last of the states or outputs that were `predicted`.
    """
    model = known_model(basis, "typical")
    assert isinstance(basis, ModelBasis)
    if basis.x0_error:
        raise InputError("`typical` needs an exact x0, not an Uncertain one")
    window, assumed, rows = model.window, model.assumptions, model.n_outputs
    if assumed.tail:
        raise InputError("`typical` is not for models with a tail: its law is not known")
    law = model._law(windows=True)
    nu = law[-1]
    if assumed.known is None and nu < 2 * rows:
        raise InputError(
            f"`typical` needs {2 * rows} more pairs than unknowns of a row where the covariance "
            f"is unknown, this model has {nu}"
        )
    key, threads, goal = bytes(as_key(rng).child("typical")), get_num_threads(), basis.target
    if goal is None:
        goal = predicted[1:][-(1 if window is None else window.count) :].ravel()
    exact = "states without error" if window is None else f"the window of {window.text} exact"
    said = (
        f"{assumed.text}; {exact}; number and lengths of the runs fixed beforehand; "
        f"residuals {'not tested' if model.checks is None else 'without a warning'}"
    )
    of = None if window is None else window.core

    def misses(size: int) -> Floats:
        return _core.drawn_misses(law, basis.x0, u, goal, noise, size, key, threads, of)

    return ranked(misses, certified, delta, draws, noise, said)


def ranked(
    misses: Callable[[int], Floats],
    certified: float,
    delta: float,
    draws: int,
    noise: bool,
    said: str,
) -> Typical:
    """The order statistic of so many misses."""
    count = validation.size("draws", draws)
    rank = rank_of(count, delta)
    if rank > count:
        raise SizeError(
            f"`draws` must be at least {needed(delta)} for delta={delta:g}, got {count}"
        )
    miss = _core.validation_rank(misses(count), rank)
    return Typical(miss, certified, delta, count, noise, said)


def known_model(basis: Basis | ModelBasis | None, what: str) -> Model:
    """The model of a plan whose law of the estimate can be trusted as far as is seen."""
    model = basis.model if isinstance(basis, ModelBasis) else None
    if not isinstance(model, Model):
        raise InputError(
            f"`{what}` needs a plan for a model by `identify`: only there the law of the estimate "
            "is known, and no data were looked at in between"
        )
    if model.warnings:
        raise InputError(f"`{what}` must not be trusted beside a warning: {model.warnings[0]}")
    return model
