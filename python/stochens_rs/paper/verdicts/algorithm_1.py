"""Algorithm 1 of the paper: its lines, its convergence, and the variance it is said to have."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Literal

import numpy as np

from ...rng import Key
from ...streams.stream import Stream
from ...theory.exact import best_control
from . import rationals as exact
from .records import Claim, Evidence

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Variant = Literal["consistent", "literal"]

ERROR_BOUND = 1e-9  # of the printed stopping rule
VARIANTS: tuple[Variant, ...] = ("consistent", "literal")


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
    stops: Floats


def measure(key: Key, *, runs: int = 40, steps: tuple[int, int] = (200, 2000)) -> Streamed:
    """Run both variants and the printed rule on a random system with n = 10, m = 5."""
    n, m = 10, 5
    gen = key.generator()
    A, B, x0 = gen.standard_normal((n, n)), gen.standard_normal((n, m)), gen.standard_normal(n)
    A /= np.abs(np.linalg.eigvals(A)).max()
    xf = gen.standard_normal(n)
    v = best_control(A, B, x0, xf).u
    control = {variant: np.zeros((runs, 2)) for variant in VARIANTS}
    state = {variant: np.zeros((runs, 2)) for variant in VARIANTS}
    bound, stops = np.zeros((runs, 2)), np.zeros((runs, 2))

    def error(stream: Stream) -> float:
        return float(np.linalg.norm(stream.u - v) / np.linalg.norm(v))

    for r in range(runs):
        child = key.child(str(r))
        for variant in VARIANTS:
            stream = Stream((A, B), x0, xf, rng=child, variant=variant)
            for k, upto in enumerate(steps):
                stream.step(upto - stream.steps)
                control[variant][r, k] = error(stream)
                state[variant][r, k] = np.linalg.norm(B @ (stream.u - v))
                if variant == "consistent":
                    bound[r, k] = mean_square_bound(x0, xf, A, stream.counts)
        printed = Stream((A, B), x0, xf, rng=child, variant="literal")
        if printed.run(tol=ERROR_BOUND, max_steps=steps[1], rule="printed").status == "interrupted":
            raise KeyboardInterrupt  # half a run is of no use
        stops[r] = printed.steps, error(printed)
    return Streamed(n, m, steps, control, state, bound, stops)


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
    w = exact.vector(1, 1)
    # A = B = I, xf = 0: v' = -x0(s), whose atoms differ in sign only
    means: dict[str, dict[int, Fraction]] = {"printed": {}, "fused": {}}
    for N in (4, 6, 8):
        means["printed"][N] = means["fused"][N] = exact.ZERO
        for p, samples in exact.sequences(w, N):
            means["printed"][N] += p * exact.distance(_printed(samples, w), w)
            means["fused"][N] += p * exact.slse(samples, w)[-1]
    limit = exact.distance(_printed([atom for _, atom in exact.atoms(w)] * 20, w), w)
    square = {k: (x**2).mean(axis=0) for k, x in streamed.state.items()}
    allowed = streamed.bound.mean(axis=0)
    texts = (
        "A = B = I, x0 = (1, 1), xf = 0, all sequences of N = 4, 6, 8 realizations of x0: mean "
        f"square error of the control {_list(means['printed'])} as printed, {_list(means['fused'])}"
        f" with fused estimates. Where the realizations alternate, the printed one is "
        f"{float(limit):.6f} after 40 of them: it tends to 2/9.",
        f"n = {streamed.n}, m = {streamed.m}, {len(streamed.bound)} runs: mean square error of "
        f"the state after {streamed.steps[0]} and {streamed.steps[1]} steps "
        f"{square['literal'][0]:.3g} and {square['literal'][1]:.3g} as printed, "
        f"{square['consistent'][0]:.2g} and {square['consistent'][1]:.2g} with fused estimates; "
        f"the bound for these is {allowed[0]:.3g} and {allowed[1]:.3g}.",
    )
    printed, fused = (list(means[k].values()) for k in ("printed", "fused"))
    levels = (
        min(printed) > limit and abs(limit - Fraction(2, 9)) < 1e-6 and 10 * fused[2] < fused[0]
    )
    holds = bool(
        np.all(square["consistent"] <= allowed)
        and square["literal"][1] > allowed[1]
        and square["literal"][1] > 0.5 * square["literal"][0]
    )
    return Claim(
        "Contribution vi",
        '"we also can vi) compute the variance of the state and control of a stochastic ensemble '
        'system that is obtained in an streaming fashion".',
        "false",
        "The paper has no such result, and for its Algorithm 1 the mean square error does not "
        "tend to 0. With fused estimates E||B (v - v*)||^2 <= 3 [Vf / nf + ||A||^2 V0 / n0 + (VA / "
        "nA) (||x0|| + sqrt(V0 / n0))^2] after nf, n0, nA realizations of xf, x0, A with the mean "
        "square errors Vf, V0, VA.",
        (Evidence("enumeration", texts[0], levels), Evidence("Monte Carlo", texts[1], holds)),
    )


def _printed(samples: list[exact.Vector], w: exact.Vector) -> exact.Vector:
    """The printed loop for x0 alone: old and new are the last two realizations."""
    v = old = samples[0]
    for new in samples[1:]:
        t = exact.weight(old, new, w)
        v = exact.combine(exact.ONE - t, v, t, new)
        old = new
    return v


def lines_3_and_16() -> Claim:
    """With fewer inputs than states the control of these lines does not exist."""
    A, x0, xf = (exact.vector(1, 1), exact.vector(1, 2)), exact.vector(1, 1), exact.vector(3, 4)
    b = exact.vector(1, 1)
    # B = (1, 1): B^+ = (1/2, 1/2), and y is in reach if its entries are equal
    pinv = tuple(x / exact.dot(b, b) for x in b)
    solvable, total, mean = exact.ZERO, 0, exact.ZERO
    for p, start in exact.atoms(x0):
        for q, matrix in exact.matrix_atoms(A):
            for r, goal in exact.atoms(xf):
                y = exact.combine(exact.ONE, goal, -exact.ONE, exact.apply(matrix, start))
                u = exact.dot(pinv, y)
                solvable += p * q * r * (y == tuple(u * x for x in b))
                mean += p * q * r * u
                total += 1
    y = exact.combine(exact.ONE, xf, -exact.ONE, exact.apply(A, x0))
    v = exact.dot(pinv, y)
    text = (
        f"n = 2, m = 1, A = [[1, 1], [1, 2]], B = (1, 1), x0 = (1, 1), xf = (3, 4) = A x0 + {v} B: "
        f"of all {total} combinations of realizations the share {solvable} has a solution. The "
        f"least-squares controls have the mean {mean}."
    )
    return Claim(
        "Algorithm 1, lines 3 and 16",
        "\"v <- v' such that xf^ = A^ x0^ + B v'\".",
        "holds with a correction",
        "For m < n there is in general no such v', even where xf can be reached. Use the "
        "least-squares solution B^+ (xf^ - A^ x0^), as in the paper's simulations. With B square "
        "and invertible the lines can be carried out.",
        (
            Evidence(
                "enumeration",
                text,
                y == tuple(v * x for x in b) and solvable == 0 and mean == v,
            ),
        ),
    )


def algorithm_1(streamed: Streamed) -> Claim:
    """The printed loop stops at a useless sample and does not converge."""
    stop, left = np.median(streamed.stops, axis=0)
    literal, consistent = (
        float(np.median(streamed.control[k][:, 1])) for k in ("literal", "consistent")
    )
    texts = (
        f"n = {streamed.n}, m = {streamed.m}, {len(streamed.stops)} runs of {streamed.steps[1]} "
        f"steps: median relative error of the control {literal:.2g} as printed (old and new: the "
        f"last two realizations), {consistent:.2g} with fused estimates in all slots.",
        f"errorBound 1e-9: the printed rule stops after {stop:g} steps in the median, at a median "
        f"relative error of {left:.2g}.",
    )
    return Claim(
        "Algorithm 1",
        "Replacing one of x0(s), xf(s), A(s) at a time, v <- w1 v + w2 v' with the weights of a "
        "line search, until ||(w1 - 1) v + w2 v'|| falls below errorBound, computes the control.",
        "false",
        "Keep the fused estimates and put the new sample into its slot, with the fused values in "
        "the other two: then v = B^+ (Ff - FA F0) holds exactly after every step, and v "
        "converges. The printed error is the length of the last change, which is 0 after every "
        "sample that does not help. A bound of the error is ||P [(Ff - xf) - A (F0 - x0)]|| + "
        "||FA - A|| ||F0||.",
        (
            Evidence("Monte Carlo", texts[0], literal > 0.5 and consistent < 0.2 * literal),
            Evidence("Monte Carlo", texts[1], bool(stop <= 50 and left > 0.5)),
        ),
    )


def _list(means: dict[int, Fraction]) -> str:
    return ", ".join(f"{float(x):.3g}" for x in means.values())
