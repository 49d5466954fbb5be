"""Every guarantee on systems of every kind, also those that it was not written for.

A case draws a system of a kind and data, and returns for each number of a guarantee how large the
true error is beside its bound: above 1 the guarantee fails, which it may in a share DELTA of the
runs (`Guarantee.rate`). Counts are judged for each number by `coverage_study.at_most`, summed over
all kinds and for each kind alone: a false alarm of at most 1e-5 for each of the about 1700 counts,
once and for all, as seeds are fixed. `Guarantee.mutant` is a share of the bounds that fails too
often: smaller bounds are seen, by each number.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
import pytest
from scipy import stats

import stochens_rs as se
import tail_bounds as bounds
from coverage_study import ALARM, at_most, sets
from declarations import opts
from hidden_systems import KINDS, NOISES, covariance, drawn
from limit_plans import within
from stochens_rs.exceptions import DataWarning
from stochens_rs.rng import as_key
from stochens_rs.theory import drawn_bounds as drawn_errors
from stochens_rs.theory import moments
from stochens_rs.theory.exact import best_control

DELTA = 0.1
LIMITS = (-0.3, 0.3)
SINGULAR = ("one_force", "some_states")  # refused as a known covariance


class Guarantee(NamedTuple):
    """What ``case(gen, system)`` yields: rows of shares, one for each number of the guarantee.

    `without`: kinds that its assumptions do not allow.
    """

    case: Callable[..., Any]
    mutant: float | tuple[float, ...]
    times: int = 1  # systems of a kind
    rate: float = DELTA
    without: tuple[str, ...] = ()


def share(error, bound, rounding=0.0):
    """The least that the error can be, with its own rounding, over its bound."""
    off = max(0.0, float(error - rounding))
    return off / bound if off and bound else (np.inf if off else 0.0)


def ends(gen, system, sizes=1.0):
    return gen.standard_normal((2, len(system.A))) * sizes


def rolled(system, x0, u, noise=None):
    """The states (K + 1, n) of the true system, in extended precision."""
    A, B = (M.astype(np.longdouble) for M in system[1:])
    path = [np.asarray(x0, dtype=np.longdouble)]
    for k in range(len(u)):
        path.append(A @ path[-1] + B @ u[k] + (0.0 if noise is None else noise[k]))
    return np.array(path)


def lengths(v):
    return np.sqrt(np.sum(v * v, axis=-1))


# -- realizations of exact systems -----------------------------------------------------------------


def estimates(gen, system, x0, xf, size=30, **options):
    """Ensembles of A, x0 and xf."""
    some = (system.A, options), (x0, {}), (xf, {})
    scheme = {k: v for k, v in options.items() if k == "scheme"}
    return [
        se.sample(w, size, rng=int(gen.integers(2**40)), **{**scheme, **more}) for w, more in some
    ]


def plans(*, formula=False, count=10, steps=1, fusion="product", **options):
    """`Plan.bound` and the errors of some plans, each from new realizations.

    The simulated bound is one for all of them, as no realization has a part in it.
    """

    def case(gen, system):
        x0, xf = ends(gen, system)
        truth, bound = se.System(system.A, system.B), None
        for _ in range(count):
            A, start, goal = estimates(gen, system, x0, xf, **options)
            plan = se.control((A, system.B), start, goal, steps=steps, fusion=fusion)
            if bound is None or bound["state"].method != "simulated":
                bound = plan.bound(DELTA)
            assert formula == any(one.reason for one in bound.quantities.values())
            error = plan.error(truth, x0, xf)
            yield (
                share(error.state, bound.state, error.state_rounding),
                share(error.control, bound.control, error.control_rounding),
                share(lengths(rolled(system, x0, plan.u)[-1] - xf), bound.target),
            )

    return case


def every_formula(quantity, **options):
    """Each formula beside 100 errors drawn from the law."""

    def case(gen, system):
        x0, xf = ends(gen, system)
        data = {"vector": (x0,), "matrix": (system.A,)}.get(quantity, (system[1:], x0, xf))
        N, key = int(gen.choice([1, 5, 50])), as_key(int(gen.integers(2**40)))
        law = bounds.bound("simulated", quantity, *data, **options).errors(N)
        which = int(quantity == "control")
        # formulas are for exact averages: their rounding, and that of the control of them
        best, rounding = getattr(law, "best", None), law.rounded((0.0, 0.0))[which]
        if best is not None:
            rounding += (2.0 * best.unsure, best.amplified(2.0 * best.unsure))[which]
        radii = [one.radius(N, DELTA) for one in bounds.candidates(quantity, *data, **options)]
        for error in law.draw(100, key)[:, which]:
            yield [share(error, radius, rounding) for radius in radii]

    return case


def fits(gen, system):
    """Nothing is random: the bound holds in every run, so that it may fail in none."""
    x0, xf = ends(gen, system)
    truth = se.System(system.A, system.B)
    A, start, goal = (
        se.fuse(e, "alse", target=w)
        for e, w in zip(estimates(gen, system, x0, xf), (system.A, x0, xf), strict=True)
    )
    for steps in (1, 3):
        plan = se.control((A, system.B), start, goal, steps=steps)
        bound, error = plan.bound(DELTA), plan.error(truth, x0, xf)
        yield (
            share(error.state, bound.state, error.state_rounding),
            share(error.control, bound.control, error.control_rounding),
        )


def limited(*, steps, uncertain, formula=False, count=4, R=0.1):
    """Plans within limits, beside the best control within them for the exact system."""

    def case(gen, system):
        x0, xf = ends(gen, system)
        bound = None
        for _ in range(count):
            A, start, goal = estimates(gen, system, x0, xf)
            matrix = A if uncertain else system.A
            how = {"steps": steps, "limits": LIMITS, "R": R}
            plan = se.control((matrix, system.B), start, goal, **within(**how))
            if bound is None or bound["state"].method != "simulated":
                bound = plan.bound(DELTA)
            assert formula == any(one.reason for one in bound.quantities.values())
            v = se.control((system.A, system.B), x0, xf, **within(**how)).limited
            wrong = (plan.u - v.u).astype(np.longdouble)
            reached = rolled(system, 0.0 * x0, wrong)[-1]
            cost = R * np.sum(wrong * (wrong + 2 * v.u))
            away = rolled(system, x0, v.u)[-1] - xf
            excess = cost + reached @ (reached + 2 * away)
            yield (
                share(lengths(reached), bound.state, v.distance),
                share(lengths(wrong.ravel()), bound.control, v.distance / R**0.5),
                share(excess, bound.excess),
            )

    return case


def streams(gen, system):
    """`DataStream.confidence` at 5 numbers of realizations: any of them may fail in a run."""
    x0, xf = ends(gen, system)
    means = {"x0": x0, "xf": xf, "A": system.A}
    spread = {name: 0.5 * np.abs(w) + 1e-3 for name, w in means.items()}
    ranges = {name: 2.001 * float(np.linalg.norm(s)) for name, s in spread.items()}
    exact = best_control(system.A, system.B, x0, xf, 1)
    for _ in range(4):
        stream, worst = se.DataStream(system.B, ranges=ranges), np.zeros(4)
        for size in (2, 5, 13, 80, 300):
            stream.update(
                **{
                    name: w + spread[name] * gen.choice([-1.0, 1.0], (size, *w.shape))
                    for name, w in means.items()
                }
            )
            found = stream.confidence(DELTA)
            assert found.kind == "guaranteed"
            error = exact.error(stream.u, x0)
            now = [share(error.state, found.state, error.state_rounding)]
            for name, w in means.items():
                off = np.linalg.norm(stream.estimates[name] - w)
                now.append(share(off, found[name].radius))
            worst = np.maximum(worst, now)
        yield worst


def moments_of_errors(gen, system):
    """The exact root mean square error beside that of 4000 simulated ones: six standard errors."""
    x0, xf = ends(gen, system)
    data, N = (se.System(system.A, system.B), x0, xf), 7
    for fusion in ("product", "diagonal"):
        law = bounds.bound("simulated", "state", *data, fusion=fusion).errors(N)
        squares = law.draw(4000, as_key(int(gen.integers(2**40)))) ** 2
        rounding = np.add(law.rounded((0.0, 0.0)), 2.0 * law.best.amplified(law.best.unsure))
        row = []
        for k, rms in enumerate((moments.state_rms, moments.control_rms)):
            exact = rms(*data, N, fusion=fusion) ** 2
            spread = 6.0 * squares[:, k].std() / np.sqrt(4000) + 1e-9 * exact + rounding[k] ** 2
            row.append(share(abs(squares[:, k].mean() - exact), spread))
        yield row


# -- measured runs ---------------------------------------------------------------------------------


class Runs(NamedTuple):
    """Runs with noise of one of the kinds of `NOISES`: ``w = root z``, and the sizes of states."""

    data: se.Trajectories
    covariance: np.ndarray
    root: np.ndarray
    sizes: np.ndarray


def measured(gen, system, *, pairs=False, known=False):
    n, m = system.B.shape
    # in the units of the states: else their rounding is larger than the noise
    sizes = lengths(system.B) if system.kind == "mixed_state_units" else np.ones(n)
    some = [name for name in NOISES if not (known and name in SINGULAR)]
    S = 0.01 * sizes[:, None] * covariance(gen.choice(some), gen, n) * sizes
    scaled = np.linalg.svd(S / np.outer(sizes, sizes))
    root = sizes[:, None] * scaled[0] * np.sqrt(scaled[1])
    count, T = (30, 1) if pairs else (40, 5)
    x, u = np.zeros((count, T + 1, n)), gen.standard_normal((count, T, m))
    x[:, 0] = gen.standard_normal((count, n)) * sizes
    for k in range(T):
        w = gen.standard_normal((count, n)) @ root.T
        x[:, k + 1] = x[:, k] @ system.A.T + u[:, k] @ system.B.T + w
    data = se.Trajectories(x, u)
    return Runs(data.last_pairs() if pairs else data, S, root, sizes)


def outside(model, system, region):
    """2 where the true model is outside, 1 where it is if the region is ten times smaller."""
    A, B = (
        found + 10.0 * (true - found) for found, true in ((model.A, system.A), (model.B, system.B))
    )
    if not region.contains(system.A, system.B):
        return 2.0
    return float(not region.contains(A, B))


def scale(runs):
    return np.concatenate([runs.sizes, np.ones(runs.data.m)])


def regions(design, known):
    """`Region.contains`."""

    def case(gen, system):
        runs = measured(gen, system, pairs=design == "independent", known=known)
        how = {"covariance": runs.covariance} if known else {}
        model = se.identify(
            runs.data, **opts(design=design, checks=False, scale=scale(runs), **how)
        )
        yield [outside(model, system, model.region(DELTA))]

    return case


def certificates(*, design="adaptive", noise=False, **options):
    """`Certificate.target`, `state`, `tube`, `components` of the true trajectory."""

    def case(gen, system):
        runs = measured(gen, system, pairs=design == "independent", known=noise)
        how = {"covariance": runs.covariance} if noise else {}
        model = se.identify(
            runs.data, **opts(design=design, checks=False, scale=scale(runs), **how)
        )
        x0, xf = ends(gen, system, runs.sizes)
        for steps in (1, 3):
            plan = se.control(model, x0, xf, steps=steps, **within(**options))
            found = plan.bound(DELTA, noise=noise)
            w = gen.standard_normal((steps, len(x0))) @ runs.root.T if noise else None
            path = rolled(system, x0, plan.u, w)
            off = lengths(path - plan.predicted_states)
            yield (
                share(lengths(path[-1] - xf), found.target),
                share(off[-1], found.state),
                max(share(*both) for both in zip(off, found.tube, strict=True)),
                max(share(*b) for b in zip(abs(path[-1] - xf), found.components, strict=True)),
            )

    return case


def looks(gen, system):
    """`ModelStream.look`: any of three, with feedback from the looks themselves."""
    n, m = system.B.shape
    runs, worst = measured(gen, system, known=True), np.zeros(2)
    stream = se.ModelStream(
        n, m, scale=scale(runs), delta=DELTA, noise=se.Noise(covariance=runs.covariance)
    )
    for first, last in ((0, 3), (3, 10), (10, 40)):
        for x, u in runs.data.runs[first:last]:
            stream.update(x[:-1], u, x[1:])
        x0, xf = ends(gen, system, runs.sizes)
        found = stream.look(x0, xf, tol=0.1, steps=2)
        reached = rolled(system, x0, found.u)[-1]
        off = outside(stream.model, system, stream.model.region())
        worst = np.maximum(worst, [share(lengths(reached - xf), found.certificate.target), off])
    yield worst


# -- fleets ----------------------------------------------------------------------------------------


def fleets(gen, system):
    """The share of 500 fresh units that miss more, beside the bounds for it; beta = DELTA."""
    N, fresh = 60, 500
    A, B = (
        M + 0.2 * np.abs(M) * gen.standard_normal((N + fresh + N, *M.shape)) for M in system[1:]
    )
    x0, xf = ends(gen, system)
    units = se.SystemEnsemble(A[:N], B[:N])
    plan = se.control_fleet(units, x0, xf, 1, limits=LIMITS, risk="worst")
    level = 0.8 * plan.threshold
    others = se.SystemEnsemble(A[N:-N], B[N:-N])

    def risk(threshold=None):
        return plan.validate(others, DELTA, threshold=threshold).count / fresh

    # where the solver does not reach its optimum only the support speaks for the command
    method = "a priori" if plan.status == "optimal" else "compression"
    held = plan.validate(se.SystemEnsemble(A[-N:], B[-N:]), DELTA, threshold=level)
    yield (
        share(risk(), plan.certify(DELTA, method=method).epsilon),
        share(risk(plan.certify(DELTA).threshold), plan.certify(DELTA).epsilon),
        share(risk(level), held.epsilon),
    )


# -- all of them -----------------------------------------------------------------------------------

UNITS = ("mixed_state_units",)
GUARANTEES = {
    "simulated": Guarantee(plans(), (0.5, 0.5, 0.9)),
    "simulated, diagonal": Guarantee(plans(fusion="diagonal"), (0.5, 0.5, 0.9)),
    "simulated, systematic": Guarantee(plans(scheme="systematic"), (0.5, 0.5, 0.9)),
    "simulated, rows": Guarantee(plans(axis="rows"), (0.5, 0.5, 0.9)),
    "simulated, three steps": Guarantee(plans(steps=3), 0.5),
    "every formula, vector": Guarantee(every_formula("vector"), 0.5),
    "every formula, matrix": Guarantee(every_formula("matrix"), 0.5),
    "every formula, state": Guarantee(every_formula("state"), 0.3),
    "every formula, control": Guarantee(every_formula("control"), 0.3),
    "every formula, diagonal": Guarantee(every_formula("state", fusion="diagonal"), 0.3),
    "every formula, rows": Guarantee(every_formula("state", axis="rows"), 0.2),
    "formula": Guarantee(plans(formula=True, count=4), (0.2, 0.15, 0.2)),
    "formula, diagonal": Guarantee(plans(formula=True, count=4, fusion="diagonal"), 0.2),
    "formula, systematic": Guarantee(
        plans(formula=True, count=4, scheme="systematic"), (0.08, 0.07, 0.5)
    ),
    "formula, three steps": Guarantee(plans(formula=True, count=4, steps=3), (0.06, 0.03, 0.06)),
    "fits": Guarantee(fits, 0.99, rate=0.0),
    "limits": Guarantee(limited(steps=1, uncertain=True), (0.2, 0.05, 0.05)),
    "limits, exact A": Guarantee(limited(steps=3, uncertain=False), (0.2, 0.05, 0.05)),
    "limits, three steps": Guarantee(limited(steps=3, uncertain=True), (0.5, 0.5, 0.3)),
    "limits, formula": Guarantee(
        limited(steps=1, uncertain=True, formula=True, count=2), (0.02, 5e-3, 4e-4)
    ),
    "limits, three steps, formula": Guarantee(
        limited(steps=3, uncertain=True, formula=True, count=2), (0.01, 2e-3, 1e-3)
    ),
    "DataStream": Guarantee(streams, (0.08, 0.3, 0.3, 0.3)),
    # rare hits make nearly all of the variance: the mean of 4000 squares is not normal
    "moments": Guarantee(moments_of_errors, 0.05, without=UNITS),
    "regions": Guarantee(regions("adaptive", False), 0.5, sets(8, 4)),
    # states of 1e10 are rounded by more than a noise of 1e-7
    "regions, known noise": Guarantee(
        regions("adaptive", True), 0.5, sets(8, 4), without=("one_huge_entry",)
    ),
    "regions, pairs": Guarantee(regions("independent", False), 0.5, sets(8, 4)),
    "certificates": Guarantee(certificates(), (0.1, 0.05, 0.08, 0.15), 3),
    "certificates, pairs": Guarantee(certificates(design="independent"), (0.1, 0.15, 0.2, 0.7), 3),
    "certificates, noise": Guarantee(certificates(noise=True), (0.38, 0.15, 0.2, 0.6), 3),
    "certificates, limits": Guarantee(
        certificates(limits=LIMITS, R=0.1), (0.7, 0.08, 0.12, 0.8), 2
    ),
    "looks": Guarantee(looks, (0.1, 0.5), sets(2, 1)),
    "fleets": Guarantee(fleets, (0.15, 0.1, 0.9), sets(5, 3)),
}


@pytest.fixture
def few(name, monkeypatch):
    """Few simulated errors, or none where a formula is asked for."""
    monkeypatch.setattr(drawn_errors, "_FEWEST", 500)
    monkeypatch.setattr(drawn_errors, "_RUNS", 20.0)
    if "formula" in name and "every" not in name:
        monkeypatch.setattr(drawn_errors, "_MOST", 1)


@pytest.mark.parametrize("name", GUARANTEES)
def test_a_guarantee_holds_on_every_kind(name, few):
    case, mutant, times, rate, without = GUARANTEES[name]
    assert set(without) <= set(KINDS)
    found = []
    for kind in KINDS:
        if kind in without:
            continue
        gen = np.random.default_rng([crc32(name.encode()), crc32(kind.encode())])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataWarning)
            rows = [row for _ in range(times) for row in case(gen, drawn(kind, gen))]
        found.append(np.array(rows))
        at_most((found[-1] > 1.0).sum(axis=0), len(rows), rate)
    shares = np.concatenate(found)
    at_most((shares > 1.0).sum(axis=0), len(shares), rate)
    high = stats.binom.ppf(1.0 - ALARM, len(shares), rate)
    assert ((shares > mutant).sum(axis=0) > high).all(), "a smaller bound is not seen"
