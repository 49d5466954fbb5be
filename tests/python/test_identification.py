"""`identify`, `Model` and `Region`: the numbers of the reference, the names, and the refusals."""

from __future__ import annotations

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import DELTA
from declarations import opts
from identification_data import POINT, THETA, Y, Z, check, independent, noisy_states
from stochens_rs import _core
from stochens_rs.exceptions import DataWarning, InputError
from twin import anytime as at
from twin import laws
from twin import regions as rg
from twin import residual_tests as rt
from twin import triangle as tr

pytestmark = pytest.mark.usefixtures("noise_by_formula")

DATA = se.Trajectories.from_pairs(Z[:, :2], Z[:, 2:], Y)
TWIN = tr.triangle(Z, Y)
FIT = tr.fit(TWIN)
X0, U0 = POINT[:2], POINT[2:]
TRUE = THETA[:, :2], THETA[:, 2:]


def fixed(data=DATA, **options):
    """A model of independent pairs."""
    return se.identify(data, **opts(design="independent", **options))


def theta(model):
    parts = [model.A, model.B] + ([] if model.c is None else [model.c[:, None]])
    return np.hstack(parts)


def same(region, twin, points=(POINT, [0.0, 0.0, 1.0], [3.0, -2.0, 0.1])):
    """Radius, bounds at some points, and membership of some models near the boundary."""
    check(region.radius, rg.radius(twin), rtol=1e-9)
    for z in points:
        x, u = np.asarray(z[:2]), np.asarray(z[2 : 2 + region.m])
        check(region.bound(x, u), rg.bound(twin, z), rtol=1e-9)
        check(region.component_bounds(x, u), rg.component_bounds(twin, z), rtol=1e-9)
    gen = np.random.default_rng(1)
    for _ in range(40):
        X = gen.standard_normal(twin.fitted.H.shape) * rg.radius(twin)
        other = twin.fitted.H + gen.uniform(0.1, 0.6) * X @ twin.fitted.white.T @ twin.fitted.white
        assert region.contains(other[:, :2], other[:, 2:3]) == rg.contains(twin, other)


# -- the numbers -----------------------------------------------------------------------------------


def test_the_model_is_least_squares():
    model = fixed()
    check(theta(model)[0], [0.910915759058, 0.201738164036, -0.029402089353])
    check(theta(model)[1], [-0.031460324517, 0.751160257835, 0.998148477439])
    check(model.covariance, FIT.S / 9)
    assert (model.rank, model.identifiable, model.missing) == (3, True, ())
    assert (model.size, model.n, model.m, model.c) == (12, 2, 1, None)
    check(model.triangle, TWIN.R, atol=1e-12)
    assert model.system == se.System(model.A, model.B)


def test_exact_regions_are_those_of_the_twin():
    same(fixed().region(DELTA), rg.full(TWIN, DELTA))
    check(fixed().region(DELTA).bound(X0, U0), 0.185505135251)
    check(fixed().region(DELTA).component_bounds(X0, U0)[0], 0.184570037684)
    same(fixed(covariance="scalar").region(DELTA), rg.scalar(TWIN, DELTA))
    check(fixed(covariance="scalar").region(DELTA).bound(X0, U0), 0.111280959627)
    same(fixed(sigma=0.3).region(DELTA), rg.known(TWIN, 0.3, DELTA))


def test_the_region_of_diagonal_noise_agrees_with_the_twin():
    """Both quantiles are simulated, with 20 000 draws of their own."""
    region = fixed(covariance="diagonal").region(DELTA)
    check(region.radius, rg.radius(rg.diagonal(TWIN, DELTA)), rtol=0.03)
    rows = fixed(covariance="diagonal").region(DELTA, components=True)
    check(rows.component_bounds(X0, U0), rg.row_bounds(TWIN, POINT, DELTA), rtol=1e-11)


def test_regions_of_some_directions_are_those_of_the_twin():
    Q = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0]])
    twin = rg.directions(TWIN, Q, DELTA)
    for region in (fixed().region(DELTA, directions=Q), fixed().region(DELTA, x0=[1.0, -1.0])):
        check(region.bound(X0, U0), rg.bound(twin, POINT), rtol=1e-11)
        assert region.bound([1.0, -1.01], U0) == np.inf
    assert region.bound(X0, U0) < fixed().region(DELTA).bound(X0, U0)


@pytest.mark.parametrize("sizes", [[1.0, 1.0, 1e8, 1e-8], [1e-6, 1e6, 1.0, 1.0]])
def test_regions_of_some_directions_do_not_depend_on_units(sizes):
    # a quantile for too few directions fails too often; 43 of 400 for 5 % with [1, 1e9, 1e-9]
    sizes, gen = np.array(sizes), np.random.default_rng(6)
    z, w = gen.standard_normal((20, 4)), gen.standard_normal((20, 2))
    y = z[:, :2] + 0.1 * w
    x0, u = z[0, :2], z[1, 2:]
    plain = se.Trajectories.from_pairs(z[:, :2], z[:, 2:], y)
    other = se.Trajectories.from_pairs(z[:, :2] * sizes[:2], z[:, 2:] * sizes[2:], y * sizes[:2])
    mine = fixed(plain).region(DELTA, x0=x0)
    scaled = fixed(other).region(DELTA, x0=x0 * sizes[:2])
    check(scaled.parts[0].factor, mine.parts[0].factor, rtol=1e-9)
    bounds = scaled.component_bounds(x0 * sizes[:2], u * sizes[2:])
    check(bounds / sizes[:2], mine.component_bounds(x0, u), rtol=1e-6)
    assert scaled.bound([1.0, 1.01] * (x0 * sizes[:2]), u * sizes[2:]) == np.inf
    Q = np.column_stack([np.r_[x0 * sizes[:2], 0.0, 0.0], np.eye(4)[:, 2:]])
    twin = rg.directions(tr.triangle(z * sizes, y * sizes[:2]), Q, DELTA)
    check(scaled.parts[0].factor, twin.factor, rtol=1e-9)


def test_noise_to_come_is_covered_on_request():
    region = fixed().region(DELTA, future=1)
    check(region.bound(X0, U0, noise=True), 1.173596784293)
    check(region.bound(X0, U0), rg.bound(rg.full(TWIN, DELTA, future=1), POINT), rtol=1e-11)
    with pytest.raises(InputError, match=r"`noise` needs a region of noise to come"):
        fixed().region(DELTA).bound(X0, U0, noise=True)


def test_both_norms_in_one_event():
    """Simulated with 100 000 draws; the larger covers the Frobenius norm too."""
    region, twin = fixed().region(DELTA, frobenius=True), rg.joint(TWIN, DELTA)
    check(region.radius, twin.spectral * np.sqrt(np.linalg.norm(FIT.S, 2)), rtol=0.02)
    check(region.frobenius, twin.frobenius, rtol=0.02)
    known = fixed(sigma=0.3).region(DELTA, frobenius=True)
    check(known.frobenius, np.sqrt(2 * _core.wishart_quantile(2, 3, DELTA, 1)), rtol=1e-10)


def test_a_known_covariance_may_be_a_matrix():
    root = np.array([[0.3, 0.0], [0.2, 0.5]])
    region = fixed(covariance=root @ root.T).region(DELTA)
    white = tr.triangle(Z, Y @ np.linalg.inv(root).T)
    twin = rg.known(white, 1.0, DELTA)
    for X in np.random.default_rng(2).standard_normal((30, 2, 3)):
        other = FIT.H + 0.6 * root @ X @ FIT.white
        assert region.contains(other[:, :2], other[:, 2:]) == rg.contains(
            twin, np.linalg.solve(root, other)
        )


@pytest.mark.parametrize("scale", [1.0, [5.0, 5.0, 0.2]])
def test_regions_for_any_design_are_those_of_the_twin(scale):
    sizes = np.broadcast_to(scale, 3)
    scaled = tr.triangle(Z / sizes, Y)
    lams = list(_core.mixtures()[:-1])
    for noise in ("gaussian", "sub-gaussian", "bounded"):
        region = se.identify(DATA, **opts(noise=noise, sigma=0.3, scale=scale)).region(DELTA)
        check(region.radius, rg.radius(at.known_noise(scaled, 0.3, DELTA, lams)), rtol=1e-10)
        check(
            region.bound(X0, U0),
            rg.bound(at.known_noise(scaled, 0.3, DELTA, lams), POINT / sizes),
            rtol=1e-10,
        )


def longer(seed=3, N=400, n=2, d=3):
    _, z, y = independent(np.random.default_rng(seed), n=n, d=d, N=N)
    return z, y, se.Trajectories.from_pairs(z[:, :n], z[:, n:], y)


def test_regions_of_unknown_noise_for_any_design_are_those_of_the_twin():
    z, y, data = longer()
    twin, lams = tr.triangle(z, y), list(_core.mixtures()[:-1])
    for anytime in (False, True):
        region = se.identify(data, scale=1.0).region(DELTA, method="mixture", anytime=anytime)
        expected = at.gaussian_noise(twin, DELTA, lams, anytime=anytime)
        # 1 - delta / (N (N + 1)) has 7 digits less
        check(region.radius, rg.radius(expected), rtol=1e-7 if anytime else 1e-9)
        assert np.isfinite(region.radius)
    region = se.identify(data, scale=1.0, noise=se.Noise(covariance="scalar")).region(
        DELTA, method="mixture"
    )
    check(region.radius, rg.radius(at.scalar_noise(twin, DELTA, lams)), rtol=1e-9)
    prior = {"l0": 1.0, "psi": _core.mixtures()[-1], "nu0": 4.0}
    region = se.identify(data, scale=1.0).region(DELTA, method="universal")
    check(region.radius, rg.radius(at.universal(twin, DELTA, **prior)), rtol=1e-9)


def test_the_smaller_of_two_regions_costs_half_of_delta():
    z, y, data = longer()
    twin, lams = tr.triangle(z, y), list(_core.mixtures()[:-1])
    both = [
        at.gaussian_noise(twin, DELTA / 2, lams),
        at.universal(twin, DELTA / 2, l0=1.0, psi=_core.mixtures()[-1], nu0=4.0),
    ]
    check(se.identify(data, scale=1.0).region(DELTA).radius, min(map(rg.radius, both)), rtol=1e-9)
    few = data[:12]
    assert se.identify(few).region(DELTA, method="mixture").radius == np.inf
    assert se.identify(few).region(DELTA).radius < np.inf


def test_an_offset_is_one_more_column():
    model = fixed(intercept=True)
    ones = np.column_stack([Z, np.ones(12)])
    twin = tr.triangle(ones, Y)
    check(theta(model), tr.fit(twin).H, atol=1e-12)
    region = model.region(DELTA)
    check(region.bound(X0, U0), rg.bound(rg.full(twin, DELTA), [*POINT, 1.0]), rtol=1e-10)
    assert region.contains(model.A, model.B, model.c)
    assert not region.contains(model.A, model.B, model.c + np.array([1.0, 0.0]))
    assert region.contains(model.A, model.B) == region.contains(model.A, model.B, [0.0, 0.0])
    with pytest.raises(InputError, match="`c` must be left out"):
        fixed().region(DELTA).contains(*TRUE, [1.0, 0.0])


def test_known_columns_leave_the_full_theory_for_the_others():
    model = fixed(known=(None, [[0.0], [1.0]]))
    T, Theta0 = np.eye(3)[:2], np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    twin = rg.full(rg.restricted(Z, Y, T, Theta0), DELTA)
    check(model.A, twin.fitted.H, atol=1e-12)
    np.testing.assert_array_equal(model.B, [[0.0], [1.0]])
    region = model.region(DELTA)
    check(region.bound(X0, [17.0]), rg.bound(twin, X0), rtol=1e-10)
    assert region.contains(model.A, TRUE[1])
    assert not region.contains(model.A, TRUE[1] + 1e-3)


def test_single_known_entries_are_fitted_row_by_row():
    free = np.array([[True, True, False], [True, True, True]])
    rows = rg.pattern(Z, Y, free, DELTA)
    model = fixed(known=(None, [[0.0], [np.nan]]))
    check(theta(model), rows.H, atol=1e-12)
    region = model.region(DELTA)
    check(region.component_bounds(X0, U0), rg.pattern_bounds(rows, POINT), rtol=1e-10)
    check(region.bound(X0, U0), np.linalg.norm(rg.pattern_bounds(rows, POINT)), rtol=1e-10)
    assert region.contains(model.A, model.B)
    assert not region.contains(model.A, model.B + np.array([[0.0], [1.0]]))
    assert (
        se.identify(DATA, known=(None, [[0.0], [np.nan]]), noise=se.Noise(sigma=0.3))
        .region(DELTA)
        .contains(*TRUE)
    )


def test_components_are_sharper_one_by_one():
    for options in ({}, {"covariance": "diagonal"}, {"sigma": 0.3}, {"covariance": "scalar"}):
        model = fixed(**options)
        whole, rows = model.region(DELTA), model.region(DELTA, components=True)
        assert rows.contains(model.A, model.B)
        if options in ({}, {"covariance": "diagonal"}):
            sharper, wider = (r.component_bounds(X0, U0) for r in (rows, whole))
            assert (sharper < wider).all()
    q = laws.f_upper(DELTA / 2, 3, 9) * 3 / 9
    found = fixed().region(DELTA, components=True).component_bounds(X0, U0)
    check(found, np.sqrt(q * np.diag(FIT.S)) * 0.178749950455, rtol=1e-10)


# -- data that do not determine the model ----------------------------------------------------------


def flat_data():
    """u follows the first state, so their effects cannot be told apart."""
    gen = np.random.default_rng(19)
    x = gen.standard_normal((30, 2))
    u = -2.0 * x[:, :1]
    y = x @ TRUE[0].T + u @ TRUE[1].T + 0.1 * gen.standard_normal((30, 2))
    return se.Trajectories.from_pairs(x, u, y, state_names=["pos", "vel"], input_names=["force"])


def test_what_the_data_do_not_show_is_named_and_has_no_bound():
    with pytest.warns(DataWarning, match=r"do not determine the model along pos \+ 0.5 force"):
        model = fixed(flat_data())
    assert (model.rank, model.identifiable) == (2, False)
    assert model.missing == ("pos + 0.5 force",)
    region = model.region(DELTA)
    assert region.bound([1.0, 0.3], [-2.0]) < 1.0
    assert region.bound([1.0, 0.3], [0.0]) == np.inf
    assert region.bound([0.0, 0.0], [0.0]) == 0.0
    assert not region.bounded
    assert region.contains(*TRUE)
    K = np.array([[2.0, 0.0], [5.0, 0.0]])  # acts alike on all data
    assert region.contains(TRUE[0] + K, TRUE[1] + [[1.0], [2.5]])
    assert "infinite along pos + 0.5 force" in repr(region)
    with pytest.raises(InputError, match="do not determine the model along pos"):
        model.draw(5)


def test_several_missing_directions_have_names_of_their_own():
    gen = np.random.default_rng(9)
    x = np.column_stack([gen.standard_normal(20), np.zeros(20), np.ones(20)])
    data = se.Trajectories.from_pairs(x, np.ones((20, 1)), gen.standard_normal((20, 3)))
    with pytest.warns(DataWarning):
        assert fixed(data).missing == ("x[1]", "x[2] - u[0]")
    with pytest.warns(DataWarning):
        assert fixed(data, intercept=True).missing == ("x[1]", "x[2] - 1", "u[0] - 1")


def test_fewer_pairs_than_unknowns_are_no_error():
    with pytest.warns(DataWarning, match="do not determine"):
        model = se.identify(DATA[:2])
    assert (model.rank, model.covariance, model.checks) == (2, None, None)
    assert model.region(DELTA).radius == np.inf


def test_data_without_noise_are_warned_of():
    exact = se.Trajectories.from_pairs(Z[:, :2], Z[:, 2:], Z @ THETA.T)
    with pytest.warns(DataWarning, match=r"x\[0\] and x\[1\] have no residual: computed from"):
        assert fixed(exact).checks is None
    declared = fixed(exact, exact=["x[0]", 1])
    assert declared.warnings == declared.doubts == ()
    assert declared.region(DELTA).contains(THETA[:, :2], THETA[:, 2:])
    assert declared.region(DELTA).radius < 1e-9


# -- checks ----------------------------------------------------------------------------------------


def test_p_values_agree_with_the_twin():
    """Both are ranks among simulated ones: four standard deviations of their difference."""
    _, z, y = independent(np.random.default_rng(10), n=2, d=3, N=30)
    data = se.Trajectories.from_pairs(z[:, :2], z[:, 2:], y)
    found = fixed(data, checks=False).check(4000, rng=1)
    expected = rt.p_values(z, y, 1000, np.random.default_rng(11))
    assert list(found.p_values) == list(rt.NAMES)
    p = np.array(list(found.p_values.values()))
    assert np.all(np.abs(p - expected) < 4.5 * np.sqrt(p * (1 - p) * (1 / 1000 + 1 / 4000)) + 1e-3)
    assert found.exact
    assert not se.identify(data).checks.exact
    assert fixed(data).checks.p_values == fixed(data).checks.p_values  # a fixed key


def test_a_broken_assumption_is_warned_of():
    gen = np.random.default_rng(12)
    z = gen.standard_normal((200, 3))
    grown = np.sum(z * z, axis=1, keepdims=True) * gen.standard_normal((200, 2))
    data = se.Trajectories.from_pairs(z[:, :2], z[:, 2:], z @ THETA.T + grown)
    with pytest.warns(DataWarning, match="in the residuals .*1 more warning: see model.warnings"):
        model = fixed(data)
    assert "heteroscedasticity" in model.checks.failed(0.05)
    assert "warning" in repr(model)


def test_states_read_with_error_are_seen_on_a_run(monkeypatch):
    monkeypatch.setattr("stochens_rs.identification.checks.FAULT", 5e-4)
    _, run = noisy_states(np.random.default_rng(13), 400, 0.3)
    with pytest.warns(
        DataWarning, match="explain 16 % of the variance of .*: a state that is missing"
    ):
        model = se.identify(se.Trajectories(*run))
    assert any("correlation in time in the residuals" in text for text in model.warnings)
    assert model.doubts == model.warnings[: len(model.doubts)]


# -- ensembles -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "options", [{}, {"covariance": "diagonal"}, {"covariance": "scalar"}, {"sigma": 0.3}]
)
def test_drawn_models_have_the_covariance_of_their_law(options):
    size, model = 20_000, fixed(checks=False, **options)
    found = model.draw(size, rng=4)
    models = np.concatenate([found.A, found.B], axis=2).transpose(0, 2, 1).reshape(size, -1)
    nu, S = 9, FIT.S
    noise = {
        "full": S / (nu - 3),
        "diagonal": np.diag(np.diag(S)) / (nu - 2),
        "scalar": np.trace(S) / (2 * nu - 2) * np.eye(2),
        "known": 0.09 * np.eye(2),
    }["known" if "sigma" in options else options.get("covariance", "full")]
    expected = np.kron(FIT.white.T @ FIT.white, noise)
    deviation = np.sqrt(np.diag(expected))
    assert np.all(abs(models.mean(0) - FIT.H.T.ravel()) < 5 * deviation / np.sqrt(size))
    error = (np.cov(models.T) - expected) / np.outer(deviation, deviation)
    assert abs(error).max() < 0.12


def test_ensembles_that_would_mislead_are_refused():
    with pytest.raises(InputError, match="single known entries"):
        fixed(known=(None, [[0.0], [np.nan]])).draw(3)
    with pytest.raises(InputError, match="needs Gaussian noise"):
        fixed(noise="bounded", sigma=1.0).draw(3)


# -- records ---------------------------------------------------------------------------------------


def test_a_model_is_not_taken_for_the_system():
    """A bound would be relative to the estimate, which `model.system` asks for."""
    model = fixed()
    for call in (se.System.from_any, lambda m: se.steer(m, X0, X0, 9)):
        with pytest.raises(InputError, match="estimated from data: pass its `system`"):
            call(model)
    with pytest.raises(InputError, match="estimated from data"):
        se.theory.drawn_bound("state", model, X0, X0, size=9, delta=0.1)
    exact, known = se.control(model.system, X0, X0), se.control(model, X0, X0)
    assert exact.bound().kind == "certain"
    np.testing.assert_array_equal(exact.u, known.u)
    assert known.bound().state > exact.bound().state


@pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
def test_a_region_of_rounding_bounds_nothing_that_the_data_do_not_determine():
    x = np.arange(6.0)[:, None]
    exact = se.Trajectories.from_pairs(x, 0.0 * x, 2.0 * x)  # no residual
    still = se.Trajectories.from_pairs(0.0 * x, 0.0 * x, x)
    for region, known, rounding in (
        (se.identify(exact, noise=se.Noise(design="independent")).region(), [1.0], 1e-11),
        (se.identify(still, noise=se.Noise(sigma=0.1)).region(), [0.0], 0.0),
    ):
        assert region.radius <= rounding
        assert region.bound(known, [0.0]) <= rounding
        assert region.bound([1.0], [1.0]) == np.inf
        assert region.component_bounds([0.0], [1.0]) == [np.inf]
