"""`Plan.bound` and `Plan.covariance`: their values, and the cases they refuse."""

from __future__ import annotations

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs.exceptions import InputError
from stochens_rs.rng import as_key
from stochens_rs.theory import drawn_bound, moments

A = np.array([[0.9, 0.2, -0.1], [-0.1, 0.8, 0.3], [0.0, 0.4, 0.5]])
B = np.array([[1.0, 0.0], [0.5, 1.0], [0.0, -0.3]])
X0, XF = np.array([1.0, 2.0, -0.5]), np.array([0.5, 0.0, 1.0])
SYSTEM = se.System(A, B)
N = 400


def ensembles(seed=2, size=N, **options):
    key = as_key(seed)
    return [
        se.sample(target, size, rng=key.child(name), **options)
        for name, target in (("x0", X0), ("xf", XF), ("A", A))
    ]


def planned(*, fusion="product", **options):
    x0, xf, matrix = ensembles(**options)
    return se.control((matrix, B), x0, xf, fusion=fusion)


@pytest.mark.parametrize("fusion", ["product", "diagonal"])
@pytest.mark.parametrize("axis", ["columns", "rows"])
def test_a_plan_of_drawn_ensembles_needs_nothing(fusion, axis):
    plan = planned(axis=axis, fusion=fusion)
    bound = plan.bound(0.02)
    sizes = (N, N, N)
    rare = plan.bound(1e-9)  # cannot be simulated
    for quantity in ("state", "control"):
        for found in (bound, rare):
            radius, method = drawn_bound(
                quantity, (A, B), X0, XF, size=sizes, delta=found.delta, fusion=fusion, axis=axis
            )
            # and the rounding of the control
            assert getattr(found, quantity) == pytest.approx(radius, rel=1e-12)
            assert found[quantity].method == method
    assert (bound.delta, bound.kind) == (0.02, "guaranteed")
    assert "those that the realizations were drawn from" in bound.assumption
    assert bound["state"].method == "simulated" != rare["state"].method
    residual = plan.error(SYSTEM, X0, XF).residual
    assert bound.target == pytest.approx(np.hypot(bound.state, residual), rel=1e-12)
    of = {"state": moments.state_covariance, "control": moments.control_covariance}
    for quantity, formula in of.items():
        expected = formula((A, B), X0, XF, N, fusion=fusion, axis=axis)
        np.testing.assert_array_equal(plan.covariance(quantity), expected)
    np.testing.assert_array_equal(plan.covariance(), plan.covariance("state"))
    error = plan.error(SYSTEM, X0, XF)
    assert error.state <= bound.state
    assert error.control <= bound.control


def test_counts_uniform_fits_and_exact_entities_know_their_law():
    x0 = se.sample_counts(X0, 10**9, rng=1)
    xf = se.fuse(se.sample(XF, N, rng=2))
    plan = se.control((A, B), x0, xf)
    sizes = (10**9, N, None)
    best, _ = drawn_bound("state", (A, B), X0, XF, size=sizes, delta=0.05)
    assert plan.bound().state == pytest.approx(best, rel=1e-12)
    np.testing.assert_array_equal(
        plan.covariance("control"), moments.control_covariance((A, B), X0, XF, sizes)
    )
    exact = se.control((A, B), X0, XF)
    residual = exact.bound().target
    assert residual == pytest.approx(exact.reachability.residual, rel=1e-12)
    bound = exact.bound(0.5)
    assert (bound["state"].method, bound.kind) == ("exact error", "certain")
    assert {one.probability for one in bound.quantities.values()} == {1.0}
    # an exact control is wrong by rounding
    known = exact.error(SYSTEM, X0, XF)
    assert 0.0 < known.state_rounding <= bound.state < 1e-14
    assert 0.0 < known.control_rounding <= bound.control < 1e-14
    assert not exact.covariance().any()
    prefix = se.control((A, B), X0, se.sample(XF, N, rng=2).prefix(50))
    best, _ = drawn_bound("state", (A, B), X0, XF, size=(None, 50, None), delta=0.05)
    assert prefix.bound().state == pytest.approx(best, rel=1e-12)


@pytest.mark.parametrize("method", ["alse", "slse", "slse-safeguarded"])
def test_the_error_of_fits_is_known(method):
    targets = {"x0": X0 + 0.01, "xf": XF, "A": A - 0.02}
    x0, xf, matrix = (
        se.fuse(e, method, target=t) for e, t in zip(ensembles(), targets.values(), strict=True)
    )
    nominal = se.System(targets["A"], B)
    for steps in (1, 3):
        plan = se.control((matrix, B), x0, xf, steps=steps)
        bound = plan.bound()
        assert (bound.kind, bound["state"].method) == ("certain", "exact error")
        assert "targets of the fits" in bound.assumption
        assert bound.to_dict() == {**plan.bound(0.4).to_dict(), "delta": 0.05}
        error = plan.error(nominal, targets["x0"], targets["xf"])
        for name in ("state", "control"):
            assert getattr(error, name) <= getattr(bound, name)
            assert getattr(bound, name) == pytest.approx(getattr(error, name), rel=1e-9, abs=1e-11)
        # the mutant: a bound relative to something else than the targets
        other = plan.error(SYSTEM, X0, XF)
        assert abs(other.state - bound.state) > 1e-3
        with pytest.raises(InputError, match="weights of `x0` depend"):
            plan.covariance()


def test_systematic_samples():
    plan = planned(scheme="systematic")
    bound = plan.bound(0.3)
    assert (bound.kind, bound["state"].method) == ("guaranteed", "simulated")
    rare = plan.bound(1e-9)
    assert rare["state"].method == "sum of errors"
    error = plan.error(SYSTEM, X0, XF)
    assert error.state <= rare.state
    assert error.control <= rare.control
    assert bound.state < rare.state
    expected = moments.control_covariance((A, B), X0, XF, N, scheme="systematic")
    np.testing.assert_array_equal(plan.covariance("control"), expected)
    mixed = se.control((A, B), ensembles()[0], ensembles(scheme="systematic")[1])
    with pytest.raises(InputError, match="iid and systematic samples together"):
        mixed.covariance()
    paired = planned(scheme="systematic", fusion="diagonal")
    assert paired.bound(0.3).state > bound.state
    with pytest.raises(InputError, match=r"fusion='product'\), and `delta` must be at least"):
        paired.bound(1e-9)
    rows = planned(scheme="systematic", axis="rows", fusion="diagonal")
    with pytest.raises(InputError, match="fusion='product'"):
        rows.bound()
    with pytest.raises(InputError, match="systematic"):
        paired.covariance()


@pytest.mark.parametrize("steps", [1, 3])
@pytest.mark.parametrize("limits", [None, (-1.0, 1.0)])
def test_the_method_and_its_reason_are_named(steps, limits):
    x0, xf, matrix = ensembles()
    plan = se.control(
        (matrix, B),
        x0,
        xf,
        steps=steps,
        limits=limits,
        cost=se.Cost(R=None if limits is None else 1),
    )
    often, rare = plan.bound(0.02), plan.bound(1e-9)
    if limits is None or steps > 1:
        assert often["state"].reason is None
        assert "simulated" in repr(often)
    assert rare["state"].method != "simulated"
    assert "`delta` must be at least" in rare["state"].reason
    assert "got 1e-09" in repr(rare)
    assert rare["state"].method in repr(rare)
    assert rare["state"].reason in rare._repr_html_()


def test_fits_beside_samples():
    """Fitted entities have fixed errors; only drawn ones share delta."""
    x0, xf, matrix = ensembles()
    fit = se.fuse(matrix, "alse", target=A)
    plan = se.control((fit, B), x0, xf)
    bound = plan.bound(0.1)
    assert bound.kind == "guaranteed"
    assert "targets of the fits" in bound.assumption
    e0, ef = (drawn_bound("vector", w, size=N, delta=5e-10)[0] for w in (X0, XF))
    eA = np.linalg.norm(fit.estimate - A, 2)
    expected = [  # by the triangle inequality, through B B^+ and B^+
        np.linalg.norm(P, 2) * (ef + eA * (np.linalg.norm(x0.mean()) + e0))
        + np.linalg.norm(P @ fit.estimate, 2) * e0
        for P in (B @ np.linalg.pinv(B), np.linalg.pinv(B))
    ]
    rare = plan.bound(1e-9)
    assert (rare.state, rare.control) == pytest.approx(expected, rel=1e-12)
    # 400 other samples of x0 and xf beside the same fit: 40 failures expected, 64 = 4 standard
    # errors more; half the radius fails more often
    failed = halved = 0
    for seed in range(400):
        start, goal, _ = ensembles(seed=seed + 10)
        error = se.control((fit, B), start, goal).error(SYSTEM, X0, XF)
        failed += error.state > bound.state
        halved += error.state > bound.state / 2.0
    assert failed <= 64 < halved


# -- unknown laws ----------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [1, 7, 150, 10**4])
@pytest.mark.parametrize("steps", [1, 4])
def test_dense_realizations_cannot_be_declared_singletons(size, steps):
    """Their own mean has the signs and norms of a law; but no counts of single entries."""
    rng = np.random.default_rng(size)
    dense = A + 0.01 * np.abs(A) * rng.standard_normal((size, *A.shape))
    mean = dense.mean(axis=0)
    plan = se.control((se.Ensemble.from_samples(dense), B), X0, XF, steps=steps)
    with pytest.raises(
        InputError, match=r"as singletons, with one nonzero.*plan\.validate\(fresh\)"
    ):
        plan.bound(0.05, system=(mean, B))
    vector = se.Ensemble.from_samples(X0 + 0.01 * rng.standard_normal((size, 3)))
    with pytest.raises(InputError, match="is none of such entries"):
        se.control((A, B), vector, XF, steps=steps).bound(x0=vector.mean())
    drawn = se.sample(A, size, rng=rng).dense()
    plan = se.control((se.Ensemble.from_samples(drawn), B), X0, XF, steps=steps)
    assert plan.bound(0.05, system=(A, B)).kind == "guaranteed"


def test_realizations_brought_by_the_user_need_a_declared_law():
    x0, xf, matrix = ensembles()
    known = se.control((matrix, B), x0, xf)
    brought = [se.Ensemble.from_samples(e.dense()) for e in (x0, xf, matrix)]
    plan = se.control((brought[2], B), *brought[:2])
    for call in (plan.bound, plan.covariance):
        with pytest.raises(InputError, match="law of `x0` is unknown"):
            call()
        with pytest.raises(InputError, match="law of `A` is unknown"):
            call(x0=X0, xf=XF)
    declared = plan.bound(system=SYSTEM, x0=X0, xf=XF)
    assert declared.control == pytest.approx(known.bound().control, rel=1e-12)
    np.testing.assert_array_equal(plan.covariance(system=SYSTEM, x0=X0, xf=XF), known.covariance())
    indices = se.Ensemble.from_indices(x0.indices, X0)
    given = se.control((matrix, B), indices, xf)
    with pytest.raises(InputError, match="law of `x0` is unknown"):
        given.bound()
    assert given.bound(x0=X0).to_dict() == known.bound().to_dict()
    part = se.sample(X0, 100, rng=3, scheme="systematic").prefix(7)
    with pytest.raises(InputError, match="law of `x0` is unknown"):
        se.control((A, B), part, XF).bound()


def test_a_declared_law_must_be_possible():
    rng = np.random.default_rng(5)
    noise = se.Ensemble.from_samples(X0 + rng.normal(size=(50, 3)))
    plan = se.control((A, B), noise, XF)
    with pytest.raises(InputError, match="`x0` cannot be what"):
        plan.bound(x0=X0)
    drawn = se.Ensemble.from_samples(ensembles()[0].dense())
    with pytest.raises(InputError, match="`x0` cannot be what"):
        se.control((A, B), drawn, XF).bound(x0=-X0)
    with pytest.raises(InputError, match="`x0` cannot be what"):
        se.control((A, B), drawn, XF).bound(x0=2.0 * X0)


def test_entities_with_one_key_are_not_independent():
    plan = se.control((A, B), se.sample(X0, N, rng=1), se.sample(XF, N, rng=1))
    for call in (plan.bound, plan.covariance):
        with pytest.raises(InputError, match="`x0` and `xf` have one key"):
            call()
