"""`Validation`: a control on fresh systems."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated, Literal, TypeAlias

import numpy as np

from .. import _core
from .._base import show, validation
from .._base.records import Probability, SavedRecord
from .._base.types import Floats
from ..exceptions import InputError
from ..theory import scenario

Source: TypeAlias = Literal["runs", "runs of a loop", "fresh systems"]

_SAME = {
    "runs": (
        "the next run of this very plan: the same inputs, hardware and limits, its start drawn and "
        "its end decided by the same rule. No run was left out, whatever came of it, and plan, "
        "scale and delta were fixed before the runs were seen"
    ),
    "runs of a loop": (
        "the next run of this very loop: the same controller, set points, hardware and limits, its "
        "start drawn and its end decided by the same rule. No run was left out, whatever came of "
        "it, and controller, scale and delta were fixed before the runs were seen"
    ),
    "fresh systems": (
        "this command on one more system, drawn as these were, from a start drawn as theirs. No "
        "system was left out, and plan, scale and delta were fixed before they were seen. Only "
        "what differs between the systems is covered: no noise acts in these runs"
    ),
}


@dataclass(frozen=True, eq=False, repr=False)
class Validation(SavedRecord):
    """The next run stays in `tube`, and ends within `target`, with probability ``1 - delta`` each.

    Made by `Plan.validate` and `Regulator.validate`. It assumes nothing of the plant, of the noise
    or of the model, and says nothing of other plans: it is no certificate, and no number of it is
    added to one.

    Attributes
    ----------
    factor : float
        An order statistic of `deviations`; infinite where the runs are too few, see `reason`.
    tube : ndarray, shape (K + 1, n)
        ``|x(k) - p(k)|_i`` is at most this for all k and i at once: ``factor * scale``. p is the
        prediction from the run's own start, ``xh(k) + A_hat^k (x(0) - xh(0))``, so ``tube[0]`` is
        0. A plan that keeps no A_hat (diagonal fusion, made by hand) has ``p(k) = xh(k)``, k >= 1,
        and so has one of outputs: x are then the readings, and one of them is no start.
        Of a loop p is the loop around its own model.
    target : float
        ``||x(K) - xf||`` is at most this: an order statistic of `misses`.
    xf : ndarray, shape (n,)
        The target; where the plan has none, its last predicted state.
    delta : float
        `tube` fails with at most this probability, and so does `target`: each for itself.
    beta : float or None
        None: the probability is over the runs and the next one together. Else the runs can mislead
        with probability `beta`, and otherwise at most a share `delta` of all further runs fails.
    source : {"runs", "runs of a loop", "fresh systems"}
        What was compared with the plan or the loop.
    deviations : ndarray, shape (M,)
        Of each run, ``max |x(k) - p(k)|_i / scale(k)_i``; infinite where it diverged or ended
        early.
    misses : ndarray, shape (M,)
        ``||x(K) - xf||`` of each run.
    rank : int or None
        The order statistic is the one of this rank; ``M + 1`` where none is enough. None with
        weights.
    noise_free : float or None
        Of a plan whose runs all had the same start: with probability ``1 - delta`` the mean of
        x(K), where it ends without noise, is within this of xf. For Gaussian noise and a linear
        plant only, other than all else here; None where starts differ or a run diverged.
    """

    factor: float
    tube: Annotated[Floats, "time state", "infinite"]
    target: float
    xf: Annotated[Floats, "state"]
    delta: Probability
    beta: Probability | None
    source: Source
    deviations: Annotated[Floats, "run", "infinite"]
    misses: Annotated[Floats, "run", "infinite"]
    rank: int | None
    noise_free: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        validation.size("tube", len(self.tube))
        size = validation.size("deviations", len(self.deviations))
        if self.rank is not None:
            validation.size("rank", self.rank, maximum=size + 1)

    @property
    def size(self) -> int:
        """The number of runs M."""
        return len(self.deviations)

    @property
    def diverged(self) -> int:
        """How many runs diverged or ended early."""
        return int(np.count_nonzero(np.isinf(self.misses)))

    @property
    def covers(self) -> str:
        """Which runs the numbers are about, and what must be the same, in words."""
        text = _SAME[self.source]
        if self.rank is None:
            text += (
                "; but starts were drawn from another density than the start to come, their ratio "
                "is the declared weight, and its law is known, not estimated"
            )
        if self.beta is not None:
            text += f"; with confidence {1.0 - self.beta:.9g}, if the runs are independent"
        return text

    @property
    def reason(self) -> str | None:
        """Why `factor` or `target` is infinite; None where both are finite."""
        if np.isfinite(self.factor) and np.isfinite(self.target):
            return None
        share, runs = _percent(1.0 - self.delta), show.number_of(self.size, "run")
        if self.rank is None:
            return f"the weights of {runs} beside that of the run to come cannot support {share}"
        if self.rank <= self.size:
            return (
                f"{self.diverged} of {runs} diverged or ended early; {share} allows for "
                f"{self.size - self.rank}"
            )
        alone, sure = needed(self.delta), needed(self.delta, self.beta or 0.05)
        at = _percent(1.0 - (self.beta or 0.05))
        if self.beta is not None:
            return f"{runs} cannot support {share} with confidence {at}: {sure} are needed"
        return (
            f"{runs} cannot support {share}: {alone} are needed ({sure} to say it with confidence "
            f"{at} for these very runs); {_percent(self.size / (self.size + 1))} is possible"
        )

    def coverage(self, beta: float = 0.05) -> float:
        """Bound the share of all further runs that stay in `tube`; the same for `target`.

        Parameters
        ----------
        beta : float, default 0.05
            Probability that the bound fails, over runs that are independent of each other.

        Returns
        -------
        float
            ``1 - epsilon`` of `theory.scenario.hold_out`, with the runs above the order statistic
            as violations; the exact law of the coverage, Beta(rank, M + 1 - rank), where no two
            scores are equal, and on the safe side else.

        Raises
        ------
        InputError, InputTypeError
            If the runs have weights: no such law is known then.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> A = 0.5 + 0.01 * np.random.default_rng(1).standard_normal((60, 1, 1))
        >>> plan = se.control(([[0.5]], [[1.0]]), [1.0], [0.0], steps=3)
        >>> held = plan.validate(se.SystemEnsemble(A, np.ones((60, 1, 1))))
        >>> held.rank, round(held.coverage(), 3)
        (58, 0.899)
        """
        beta = validation.probability("beta", beta)
        if self.rank is None:
            raise InputError("`coverage` is not known for runs with weights")
        if self.rank > self.size:
            return 1.0
        return 1.0 - scenario.hold_out(self.size, self.size - self.rank, beta)

    @property
    def _share(self) -> str:
        sure = "" if self.beta is None else f" with confidence {_percent(1.0 - self.beta)}"
        return f"{_percent(1.0 - self.delta)}{sure}"

    def __repr__(self) -> str:
        of = self.source if self.size > 1 else self.source.removesuffix("s")
        if np.isfinite(self.target):
            text = f"x(K) within {self.target:.3g} of xf, tube {self.factor:.3g} scales"
            text += f", {self._share} each"
        else:
            text = f"nothing is validated: {self.reason}"
        return f"<Validation: {self.size} {of}, {text}>"

    def _repr_html_(self) -> str:
        rows = [
            ("holds for", self.covers),
            ("largest radius of the tube", show.vector(self.tube.max(axis=0))),
            ("largest miss of a run", float(self.misses.max())),
            ("without noise, if it is Gaussian", self.noise_free),
            ("diverged or ended early", self.diverged or None),
            ("why not", self.reason),
        ]
        if self.rank is not None and self.rank <= self.size:
            rows.insert(1, ("of further runs, with confidence 95 %", _percent(self.coverage())))
        return show.card(self, rows)


def needed(delta: float, beta: float | None = None) -> int:
    """The smallest number of runs that can support ``1 - delta``, with confidence ``1 - beta``."""
    if beta is not None:
        return scenario.required_scenarios(delta, 1, beta)
    return math.ceil(1 / _written(delta)) - 1


def rank_of(size: int, delta: float, beta: float | None = None) -> int:
    """The rank of the order statistic: ``size + 1`` if no score is enough.

    The smallest j with ``j >= (1 - delta) (M + 1)``; with `beta` the smallest with
    ``P(Bin(M, delta) <= M - j) <= beta``.
    """
    if beta is None:
        return size + 1 - math.floor(_written(delta) * (size + 1))
    return _core.scenario_rank(size, delta, beta)


def _written(delta: float) -> Fraction:
    """`delta` as it is written: 0.3 is 3/10, so that 0.3 * 10 is 3."""
    return Fraction(repr(delta))


def _percent(share: float) -> str:
    return f"{math.floor(1e6 * share + 1e-6) / 1e4:g} %"  # never rounded up
