"""Bounds, limits, exactness and weights per column of an ALSE fit."""

from __future__ import annotations

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs import reference
from stochens_rs.exceptions import InputError
from stochens_rs.fusion import Alse

A30 = np.random.default_rng(0).standard_normal((30, 30))
# near twice the dimension of the hull: some 20 to 600 ms of work, never less than a millisecond
HARD = se.sample(A30, 1750, rng=3)


def gap_of(fit: se.Fit, ensemble: se.Ensemble, target: np.ndarray) -> float:
    """The Frank-Wolfe gap on the simplex, from realizations written out."""
    E = ensemble.dense().reshape(ensemble.size, -1)
    slope = 2.0 * E @ (fit.weights @ E - target.ravel())
    return float(slope @ fit.weights - slope.min())


@pytest.mark.parametrize("limit", [Alse(time_limit=1e-3), Alse(max_iter=3)])
def test_a_limit_returns_the_best_weights_and_says_so(limit: Alse) -> None:
    fit = se.fuse(HARD, limit, target=A30)
    assert fit.status == "user_limit"
    assert fit.weights.min() >= 0.0
    assert fit.weights.sum() == pytest.approx(1.0, abs=1e-12)
    assert fit.gap == pytest.approx(gap_of(fit, HARD, A30), rel=1e-6)
    optimum = se.fuse(HARD, "alse", target=A30)
    assert optimum.status == "optimal"
    assert fit.lower_bound <= optimum.error <= fit.error
    assert fit.gap > 1e-9 * np.sum(A30**2)


def test_max_iter_holds_for_every_prefix() -> None:
    path = se.fuse_path(HARD, [1700, 1750], Alse(max_iter=3), target=A30)
    assert path.statuses == ("user_limit", "user_limit")


@pytest.mark.parametrize("seed", range(20))
def test_the_lower_bound_holds_and_is_not_vacuous(seed: int) -> None:
    gen = np.random.default_rng(seed)
    A = gen.standard_normal((4, 4)) * (gen.random((4, 4)) < 0.7)
    ensemble = se.sample(A, int(gen.integers(1, 7)), rng=seed)
    target = A if seed % 2 else gen.standard_normal((4, 4))
    fit = se.fuse(ensemble, "alse", target=target)
    best = reference.fusing.alse_dense(
        ensemble.dense(), target
    ).error  # active set on the samples written out
    rounding = 1e-12 * (1.0 + best)
    assert fit.lower_bound <= best + rounding
    assert fit.lower_bound >= best - np.sqrt(fit.gap) - rounding
    hit = (ensemble.dense() != 0.0).any(axis=0)
    assert fit.unseen == np.count_nonzero((target != 0.0) & ~hit)
    assert fit.error >= np.linalg.norm(target[~hit]) - rounding
    dense = se.fuse(se.Ensemble.from_samples(ensemble.dense()), "alse", target=target)
    assert dense.unseen == fit.unseen


def test_recovery_is_reported() -> None:
    A = np.random.default_rng(1).standard_normal((4, 4))
    ensemble = se.sample(A, 5000, rng=1)
    fit = se.fuse(ensemble, "alse", target=A)
    assert fit.exact
    assert (fit.status, fit.unseen) == ("optimal", 0)
    assert fit.error <= 1e-14 * np.linalg.norm(A)
    few = se.fuse(ensemble.prefix(5), "alse", target=A)
    assert not few.exact
    vector = se.fuse(se.sample(A[0], 5000, rng=2), "alse", target=A[0])
    assert vector.exact
    assert vector.unseen == 0
    part = se.fuse(se.sample([1.0, 1.0], 1, rng=2), "alse", target=[1.0, 1.0])
    assert not part.exact
    assert part.unseen == 1
    assert part.lower_bound == pytest.approx(np.sqrt(2.0), rel=1e-12)  # the simplex optimum


def test_extreme_scales_keep_the_bound_finite() -> None:
    A = np.random.default_rng(2).standard_normal((5, 5))
    for scale in (1e-170, 1e-150, 1e150):
        fit = se.fuse(se.sample(A * scale, 20, rng=1), "alse", target=A * scale)
        assert 0.0 < fit.lower_bound <= fit.error < np.inf
        line = se.fuse(se.sample(A[0] * scale, 2, rng=1), "alse", target=A[0] * scale)
        assert 0.0 <= line.lower_bound <= line.error < np.inf


# -- weights per column ---------------------------------------------------------------------------


@pytest.mark.parametrize("axis", ["columns", "rows"])
def test_every_line_is_its_own_vector_problem(axis: str) -> None:
    gen = np.random.default_rng(4)
    A = gen.standard_normal((6, 4))
    A[:, 1] = 0.0
    target = A + 0.1 * gen.standard_normal(A.shape)
    ensemble = se.sample(A, 12, rng=5, axis=axis)
    fit = se.fuse(ensemble, Alse(f"per-{axis[:-1]}"), target=target)
    lines = range(4) if axis == "columns" else range(6)
    assert fit.weights.shape == (12, len(lines))
    assert np.allclose(fit.weights.sum(axis=0), 1.0, atol=1e-12)
    dense = ensemble.dense()
    for j in lines:
        own = (slice(None), j) if axis == "columns" else (j,)
        seen = dense[(slice(None), *own)]
        best = reference.fusing.alse_dense(seen, target[own])
        assert np.allclose(fit.estimate[own], best.estimate, atol=1e-9)
        assert np.allclose(fit.weights[:, j] @ seen, fit.estimate[own], atol=1e-12)
    assert fit.status == "optimal"
    assert fit.error == pytest.approx(np.linalg.norm(fit.estimate - target), rel=1e-12)
    written = se.Ensemble.from_samples(dense)
    same = se.fuse(written, Alse(f"per-{axis[:-1]}"), target=target)
    assert np.allclose(same.estimate, fit.estimate, atol=1e-6)
    assert same.unseen == fit.unseen
    # one weight per realization is a special case, so it cannot do better
    assert fit.error <= se.fuse(ensemble, "alse", target=target).error + 1e-12


def test_columns_are_exact_once_every_entry_was_hit() -> None:
    A = np.random.default_rng(6).uniform(0.5, 1.0, (8, 8))
    ensemble = se.sample(A, 120, rng=7)
    assert (ensemble.counts() > 0).all()
    fit = se.fuse(ensemble, Alse("per-column"), target=A)
    assert fit.exact
    path = se.fuse_path(ensemble, [1, 10, 120], Alse("per-column"), target=A)
    assert path.errors[-1] == fit.error
    assert path.errors[0] > path.errors[1] > 1e-3
    assert path.errors[1] == se.fuse(ensemble.prefix(10), Alse("per-column"), target=A).error


def test_weights_per_column_go_with_product_fusion_only() -> None:
    system = se.System(A30[:5, :5], np.eye(5))
    ensemble = se.sample(system.A, 50, rng=1)
    fit = se.fuse(ensemble, Alse("per-column"), target=system.A)
    x0 = se.sample(np.ones(5), 50, rng=2)
    plan = se.control((fit, system.B), x0, np.zeros(5))
    assert plan.u[0] == pytest.approx(-(fit.estimate @ x0.mean()), abs=1e-12)
    with pytest.raises(InputError, match="fusion='product'"):
        se.control((fit, system.B), x0, np.zeros(5), fusion="diagonal")
