"""Algorithm 1 of the paper: its lines, its convergence, and the variance the paper mentions."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from itertools import pairwise, product
from math import comb
from typing import TYPE_CHECKING, Literal

import numpy as np

from stochens_rs import Key, Stream, Study, System, control, sample

from .. import rationals as exact
from ..bounds import Lemma42
from ..common import Floats
from ..repeating import HERE, Where, complete
from .records import Claim, Outcome, claim, outcome

if TYPE_CHECKING:
    Variant = Literal["consistent", "literal"]

ERROR_BOUND = 1e-9  # of the printed stopping rule
ROUNDED = 1e-9  # relative rounding of controls by two ways, condition numbers below 1e6
VARIANTS: tuple[Variant, ...] = ("consistent", "literal")
ENTITIES = ("x0", "xf", "A")


class PrintedLoop:
    """Algorithm 1 as printed: old and new are the last two realizations of a slot.

    The realizations and the choice of slots are those of a `Stream` with the same key.
    """

    most = 4096  # steps

    def __init__(self, system: System, x0: Floats, xf: Floats, *, rng: Key) -> None:
        self._targets = {"x0": x0, "xf": xf, "A": system.A}
        self._drawn = {
            name: sample(target, self.most, rng=rng.child(name)).dense()
            for name, target in self._targets.items()
        }
        chosen = sample(np.ones(3), self.most, rng=rng.child("slots")).indices
        assert chosen is not None
        self._slots, self._pinv = chosen[:, 0], np.linalg.pinv(system.B)
        self.steps, self.counts = 0, dict.fromkeys(ENTITIES, 1)
        self.u = self._control()

    @property
    def estimates(self) -> dict[str, Floats]:
        """The latest realizations."""
        return {name: self._drawn[name][count - 1] for name, count in self.counts.items()}

    def _control(self) -> Floats:
        E = self.estimates
        return np.asarray(self._pinv @ (E["xf"] - E["A"] @ E["x0"]))

    def step(self, count: int = 1) -> None:
        """``v <- (1 - t) v + t v'``, t and v' from the latest realizations."""
        for _ in range(count):
            name = ENTITIES[self._slots[self.steps]]
            old, new = self._drawn[name][self.counts[name] - 1 : self.counts[name] + 1]
            self.steps += 1
            self.counts[name] += 1
            way = new - old
            if way.any():
                t = float(((self._targets[name] - old) * way).sum() / (way * way).sum())
                t = min(max(t, 0.0), 1.0)
                self.u = (1.0 - t) * self.u + t * self._control()

    def run(self, *, tol: float, max_steps: int) -> None:
        """Stop when a step changes the control by at most `tol`, as printed."""
        for _ in range(max_steps):
            before = self.u
            self.step()
            if np.linalg.norm(self.u - before) <= tol:
                break


@dataclass(frozen=True, eq=False)
class Streamed:
    """Runs of Algorithm 1 on one system.

    Attributes
    ----------
    n, m : int
        The system's dimensions.
    steps : tuple of int
        The two numbers of steps after which the errors were taken.
    control : dict of str to ndarray, shape (runs, 2)
        ``||v - v*|| / ||v*||``, with fused estimates ("consistent") and as printed ("literal").
    state : dict of str to ndarray, shape (runs, 2)
        ``||B (v - v*)||``.
    bound : ndarray, shape (runs, 2)
        Bound on the mean of ``state^2`` for "consistent", from how often each entity was drawn.
    apart : ndarray, shape (runs, 2)
        ``||v - B^+ (Ff - FA F0)|| / ||v||`` for "consistent".
    stops : ndarray, shape (runs, 2)
        Steps after which the printed rule stops with `ERROR_BOUND`, and the relative error of the
        control then.
    """

    n: int
    m: int
    steps: tuple[int, int]
    control: dict[Variant, Floats]
    state: dict[Variant, Floats]
    bound: Floats
    apart: Floats
    stops: Floats


def measure(
    key: Key, *, runs: int = 40, steps: tuple[int, int] = (200, 2000), where: Where = HERE
) -> Streamed:
    """Run both variants and the printed rule on a random system with n = 10, m = 5."""
    n, m = 10, 5
    gen = key.generator()
    A, B, x0 = gen.standard_normal((n, n)), gen.standard_normal((n, m)), gen.standard_normal(n)
    A /= np.abs(np.linalg.eigvals(A)).max()
    function = partial(_errors, System(A, B), x0, gen.standard_normal(n), steps)
    found = complete(Study(function, {}, replicates=runs, rng=key), **where.of("algorithm-1"))
    control, state = ({v: found[f"{what}_{v}"] for v in VARIANTS} for what in ("control", "state"))
    return Streamed(n, m, steps, control, state, found["bound"], found["apart"], found["stops"])


def _errors(
    system: System, x0: Floats, xf: Floats, steps: tuple[int, int], key: Key
) -> dict[str, list[float]]:
    """One run of both variants and of the printed rule; the fields of `Streamed`."""
    A, B = system.A, system.B
    v = control((A, B), x0, xf).u[0]
    found: dict[str, list[float]] = {"bound": [], "apart": []}

    def error(stream: Stream | PrintedLoop) -> float:
        return float(np.linalg.norm(stream.u - v) / np.linalg.norm(v))

    for variant in VARIANTS:
        kind = Stream if variant == "consistent" else PrintedLoop
        stream = kind(system, x0, xf, rng=key)
        controls = found[f"control_{variant}"] = []
        state = found[f"state_{variant}"] = []
        for upto in steps:
            stream.step(upto - stream.steps)
            controls.append(error(stream))
            state.append(float(np.linalg.norm(B @ (stream.u - v))))
            if variant == "consistent":
                found["bound"].append(mean_square_bound(x0, xf, A, stream.counts))
                F = stream.estimates
                u = np.linalg.lstsq(B, F["xf"] - F["A"] @ F["x0"])[0]
                found["apart"].append(float(np.linalg.norm(stream.u - u) / np.linalg.norm(u)))
    printed = PrintedLoop(system, x0, xf, rng=key)
    printed.run(tol=ERROR_BOUND, max_steps=steps[1])
    return {**found, "stops": [printed.steps, error(printed)]}


def mean_square_bound(x0: Floats, xf: Floats, A: Floats, drawn: dict[str, int]) -> float:
    """Bound on ``E||B (v - v*)||^2`` after so many draws of each entity, with fused estimates.

    ``3 [Vf / nf + ||A||^2 V0 / n0 + (VA / nA) (||x0|| + sqrt(V0 / n0))^2]``, V the mean square
    error of one realization. SLSE after n realizations has at most V / n.
    """
    V0, Vf, VA = (
        float((np.abs(E).sum(axis=0) ** 2 - (E**2).sum(axis=0)).sum())
        for E in (x0[:, None], xf[:, None], A)
    )
    a, b, c = V0 / drawn["x0"], Vf / drawn["xf"], VA / drawn["A"]
    size = float(np.linalg.norm(A, 2)) ** 2
    return float(3.0 * (b + size * a + c * (float(np.linalg.norm(x0)) + a**0.5) ** 2))


def variance(streamed: Streamed) -> Claim:
    """The paper has no result; the mean square error of its loop does not tend to 0."""
    # A = B = I, xf = 0: v' = -x0(s), whose atoms differ in sign only
    w, sizes = exact.array([1, 1]), (4, 6, 8)
    printed, fused = [exact.ZERO] * 3, [exact.ZERO] * 3
    for k, N in enumerate(sizes):
        for p, samples in exact.sequences(w, N):
            printed[k] += p * exact.square(_printed(samples, w) - w)
            fused[k] += p * exact.slse(samples, w)[-1]
    limit = exact.square(_printed([atom for _, atom in exact.atoms(w)] * 20, w) - w)
    square = {k: (x**2).mean(axis=0) for k, x in streamed.state.items()}
    allowed = streamed.bound.mean(axis=0)
    two_ninths = abs(limit - Fraction(2, 9)) < 1e-6
    remains = square["literal"][1] > max(allowed[1], 0.5 * square["literal"][0])
    return claim(
        "Contribution vi",
        outcome(
            min(printed) > limit and two_ninths and 10 * fused[2] < fused[0],
            sizes=sizes,
            printed=printed,
            fused=fused,
            limit=float(limit),
        ),
        outcome(
            np.all(square["consistent"] <= allowed) and remains,
            streamed=streamed,
            runs=len(streamed.bound),
            square=square,
            allowed=allowed,
        ),
        _no_variance_of_averages(w),
    )


def _no_variance_of_averages(w: exact.Array) -> Outcome:
    """Lemma 4.2, which holds for averages, beside the printed loop for the same entities."""
    N, least, eps = 10_000, 10, Fraction(46, 100)
    # a realization that is drawn again changes nothing; v halves its distance to 2/3 or 1/3 of the
    # way with every change, so that the error after `least` changes is nearly that after all later
    starts = [[atom for _, atom in exact.atoms(w)], [atom for _, atom in exact.atoms(w)][::-1]]
    ends = [
        exact.square(_printed((both * N)[: changes + 1], w) - w)
        for both in starts
        for changes in range(least, 40)
    ]
    repeated = [atom for atom in starts[0] for _ in range(3)]
    same = np.array_equal(_printed(repeated, w), _printed(starts[0], w))
    few = Fraction(sum(comb(N - 1, changes) for changes in range(least)), 2 ** (N - 1))
    law = Lemma42((np.eye(2), np.eye(2)), exact.floats(w), np.zeros(2), C=2.0)
    bound = law.probability(N, float(eps))
    return outcome(
        same and min(ends) > eps**2 and 1 - few > Fraction(bound),
        N=N,
        eps=float(eps),
        least=least,
        power=len(str(few.denominator // few.numerator)) - 1,
        bound=bound,
    )


def _printed(samples: list[exact.Array], w: exact.Array) -> exact.Array:
    """The printed loop for x0 alone: old and new are the last two realizations."""
    v = samples[0]
    for old, new in pairwise(samples):
        t = exact.weight(old, new, w)
        v = (1 - t) * v + t * new
    return v


def lines_3_and_16() -> Claim:
    """With fewer inputs than states the control of these lines does not exist."""
    A, x0, xf = (exact.array(M) for M in ([[1, 1], [1, 2]], [1, 1], [3, 4]))
    b = exact.array([1, 1])
    # B = (1, 1): B^+ = (1/2, 1/2), and y is reachable if its entries are equal
    pinv = b / (b @ b)
    solvable, total, mean = exact.ZERO, 0, exact.ZERO
    for (p, start), (q, matrix), (r, goal) in product(
        exact.atoms(x0), exact.matrix_atoms(A), exact.atoms(xf)
    ):
        y = goal - matrix @ start
        u = pinv @ y
        solvable += p * q * r * np.array_equal(u * b, y)
        mean += p * q * r * u
        total += 1
    y = xf - A @ x0
    v = pinv @ y
    confirms = np.array_equal(v * b, y) and solvable == 0 and mean == v
    return claim(
        "Algorithm 1, lines 3 and 16",
        outcome(confirms, v=v, total=total, solvable=solvable, mean=mean),
    )


def algorithm_1(streamed: Streamed) -> Claim:
    """The printed loop stops at a useless sample and does not converge."""
    stop, left = np.median(streamed.stops, axis=0)
    literal, consistent = (
        float(np.median(streamed.control[k][:, 1])) for k in ("literal", "consistent")
    )
    return claim(
        "Algorithm 1",
        outcome(
            literal > 0.5 and consistent < 0.2 * literal,
            streamed=streamed,
            runs=len(streamed.stops),
            literal=literal,
            consistent=consistent,
        ),
        outcome(streamed.apart.max() <= ROUNDED, apart=streamed.apart.max(), streamed=streamed),
        outcome(stop <= 50 and left > 0.5, stop=stop, left=left),
    )
