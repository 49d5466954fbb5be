"""Regions that the core builds from data against the same in NumPy, for every kind of data."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import stochens_rs as se
from declarations import opts
from stochens_rs import _core
from stochens_rs.exceptions import DataWarning, InputError
from stochens_rs.identification.assumptions import ACCEPTED
from twin import region_from_data as rd

n, m = 3, 2
A = np.array([[0.5, 0.1, 0.0], [0.0, 0.7, 0.2], [0.1, 0.0, 0.3]])
B = np.array([[1.0, 0.0], [0.0, 1.0], [0.5, 0.5]])
SIZES = np.array([1e-6, 1.0, 1e5])  # of states in mixed units


def data(kind: str, N: int, seed: int = 3) -> se.Trajectories:
    gen = np.random.default_rng(seed)
    x, u, w = gen.standard_normal((N, n)), gen.standard_normal((N, m)), gen.standard_normal((N, n))
    if kind == "deficient":
        u[:, 1] = u[:, 0] - 2.0 * x[:, 0]
    if kind == "zero column":
        u[:, 0] = 0.0
    y = x @ A.T + u @ B.T + 0.1 * w
    if kind == "units":
        x, y = x * SIZES, y * SIZES
    return se.Trajectories.from_pairs(x, u, y)


def entries(*given: tuple[int, int, float]) -> np.ndarray:
    known = np.full((n, n), np.nan)
    for i, j, value in given:
        known[i, j] = value
    return known


KINDS = (("plain", 40), ("plain", 8), ("plain", 4), ("deficient", 40), ("zero column", 30))
KINDS = (*KINDS, ("units", 50), ("plain", 3000))
COLUMN = entries((0, 0, 0.5), (1, 0, 0.0), (2, 0, 0.1))
SINGLE = entries((0, 0, 0.5), (1, 0, 0.0), (1, 1, 0.7), (1, 2, 0.2))
DECLARED = {
    "full": {},
    "diagonal": {"covariance": "diagonal"},
    "scalar": {"covariance": "scalar"},
    "sigma": {"sigma": 0.1},
    "known": {"covariance": np.diag([0.01, 0.02, 0.03]) + 0.001},
    "sub-gaussian": {"noise": "sub-gaussian", "sigma": 0.1},
    "bounded": {"noise": "bounded", "sigma": 0.5},
    "intercept": {"intercept": True},
    "known column": {"known": (COLUMN, None)},
    "known entries": {"known": (SINGLE, None)},
    "known entries, scalar": {"known": (SINGLE, None), "covariance": "scalar"},
}
EXACT = (
    {},
    {"components": True},
    {"directions": 2},
    {"future": 3},
    {"frobenius": True},
    {"frobenius": True, "future": 2},
)
ANY = ({}, {"method": "mixture"}, {"method": "universal"}, {"anytime": True}, {"components": True})


def close(found, expected, size, rtol: float = 1e-9) -> None:
    """Equal but for rounding of what these sizes add up to."""
    assert np.shape(found) == np.shape(expected)
    assert (np.isfinite(found) == np.isfinite(expected)).all()
    finite = np.isfinite(expected)
    assert (
        np.abs(found - expected)[finite] <= rtol * np.broadcast_to(size, finite.shape)[finite]
    ).all()


def check(found: se.Region, twin: rd.Region, least: float = 1e-5) -> None:
    """Equal parts; what is below `least` is rounding of entries of size 1."""
    assert len(found.parts) == len(twin.parts)
    for part, own in zip(found.parts, twin.parts, strict=True):
        assert part.rows.tolist() == own.rows.tolist()
        assert part.columns.tolist() == own.columns.tolist()
        close(part.factor, own.factor, abs(own.factor))
        D = np.linalg.norm(own.root, axis=0) + least
        close(part.root.T @ part.root, own.root.T @ own.root, np.outer(D, D))
        D = np.linalg.norm(own.white, axis=0) + least
        close(
            part.white.T @ part.white,
            own.white.T @ own.white,
            np.outer(D, D) + 1e-25 * D.max() ** 2,
        )
        projector = [one.missing @ np.linalg.pinv(one.missing) for one in (part, own)]
        close(*projector, 1.0)
        close(part.ratio, own.ratio, own.ratio)
        s = np.sqrt(np.diag(own.S)) + least
        close(part.S, own.S, np.outer(s, s))
    close(found.centre, twin.centre, np.abs(twin.centre).max(axis=1, keepdims=True))
    assert (found.frobenius is None) == (twin.frobenius is None)
    if twin.frobenius is not None:
        close(found.frobenius, twin.frobenius, twin.frobenius)
    assert (found.noise is None) == (twin.noise is None)
    if twin.noise is not None:
        s = np.sqrt(np.diag(twin.noise))
        close(found.noise, twin.noise, np.outer(s, s))


@pytest.mark.parametrize(("kind", "N"), KINDS)
@pytest.mark.parametrize("name", DECLARED)
@pytest.mark.parametrize("design", ["adaptive", "independent"])
def test_regions_are_those_of_the_twin(kind: str, N: int, name: str, design: str) -> None:
    model = identify(data(kind, N), **opts(design=design, **DECLARED[name]))
    tried = 0
    for wish in EXACT if design == "independent" else ANY:
        asked = dict(wish)
        if "directions" in wish:
            asked["directions"] = np.eye(model._d)[:, : wish["directions"]]
        try:
            found = model.region(0.05, **asked)
        except InputError:
            continue  # no region is known
        twin = rd.region(model, rd.Wish(0.05, **asked))
        check(found, twin, least=0.0 if kind == "units" else 1e-5)
        tried += 1
    assert tried >= 1


def test_least_squares_from_rows_and_from_their_triangle() -> None:
    model = identify(data("deficient", 40))
    Z, Y = np.hsplit(model.rows, [model.rows.shape[1] - model.n])
    both = np.hstack([Z, Y])
    f, g = _core.fit(both, n + m, 40, 1), _core.fit(_core.triangle(both, 1), n + m, 40, 1)
    assert (f.H == g.H).all()
    assert (f.rank, f.nu, f.N) == (4, 36, 40)
    E = Y - Z @ f.H.T
    np.testing.assert_allclose(f.S, E.T @ E, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(f.root.T @ f.root, Z.T @ Z, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(f.combinations(), [[1.0, 0.0, 0.0, -0.5, 0.5]], atol=1e-12)


def identify(runs: se.Trajectories, **options) -> se.Model:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)
        return se.identify(runs, **opts(checks=False, accept=ACCEPTED, **options))
