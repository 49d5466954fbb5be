"""Regions where the noise has fewer sources than states, or states have mixed units.

The true system is in as often as the region says, whatever the units: the test of membership is
made in units of the residuals, with room for rounding. Data are drawn over all kinds of noise.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

import hidden_systems as hidden
import stochens_rs as se
from coverage_study import DELTA, at_most, exactly, failures

UNITS = np.array([1e8, 1e-8, 1.0, 1e4])
RUNS = 80
pytestmark = pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")


def in_units(noise: str, gen: np.random.Generator, units: np.ndarray | None):
    """A, B and a root of the covariance in these units."""
    system = hidden.drawn("dense", gen)
    root = 0.1 * hidden.NOISES[noise](gen, 4)
    size = np.ones(4) if units is None else units
    return size[:, None] * system.A / size, size[:, None] * system.B, size[:, None] * root, size


def pairs(gen, noise, units, N=40):
    A, B, root, size = in_units(noise, gen, units)
    x, u = size * gen.standard_normal((N, 4)), gen.standard_normal((N, 2))
    w = gen.standard_normal((N, root.shape[1])) @ root.T
    return A, B, se.Trajectories.from_pairs(x, u, x @ A.T + u @ B.T + w)


def a_run(gen, noise, units, T=120):
    A, B, root, size = in_units(noise, gen, units)
    x, u = [size * gen.standard_normal(4)], gen.standard_normal((T, 2))
    for acting in u:
        x.append(A @ x[-1] + B @ acting + root @ gen.standard_normal(root.shape[1]))
    return A, B, se.Trajectories(np.array(x), u), size


@pytest.mark.parametrize("units", [None, UNITS], ids=["alike", "mixed"])
@pytest.mark.parametrize("noise", hidden.NOISES)
def test_the_true_system_is_in_as_often_as_said(noise, units):
    def outside(gen):
        A, B, data = pairs(gen, noise, units)
        model = se.identify(data, checks=False, noise=se.Noise(design="independent"))
        rows = model.region(DELTA, components=True)
        return [not model.region(DELTA).contains(A, B), not rows.contains(A, B)]

    whole, rows = failures(outside, RUNS, 90)
    if noise in ("one_force", "some_states"):  # of fewer directions, at the level of all of them
        at_most(whole, RUNS)
    else:
        exactly(whole, RUNS)
    at_most(rows, RUNS)


@pytest.mark.parametrize("noise", hidden.NOISES)
def test_the_true_system_is_in_for_any_design(noise):
    def outside(gen):
        A, B, data, size = a_run(gen, noise, UNITS)
        model = se.identify(data, scale=[*size, 1.0, 1.0], checks=False)
        return not model.region(DELTA).contains(A, B)

    at_most(failures(outside, 40, 91), 40)


def test_membership_does_not_depend_on_units_nor_accept_what_is_far():
    """Singular noise: 1e-6 of its size off in a direction that is exact is outside."""
    for seed in range(20):
        verdicts = []
        for units in (None, UNITS, 1.0 / UNITS):
            gen = np.random.default_rng([92, seed])
            A, B, data = pairs(gen, "one_force", units)
            region = se.identify(data, checks=False, noise=se.Noise(design="independent")).region(
                DELTA
            )
            S, size = region.parts[0].S, np.ones(4) if units is None else units
            noise = np.sqrt(np.diag(S))
            null = np.linalg.eigh(S / noise[:, None] / noise)[1][:, 0]
            off = (noise * null)[:, None] / size  # l' off = noise, l the exact combination
            verdicts.append([region.contains(A + t * off, B) for t in (0.0, 1e-9, 1e-6, 1e-3)])
        assert verdicts[0] == verdicts[1] == verdicts[2]
        assert verdicts[0][2:] == [False, False]


def test_the_widening_by_rounding_holds_in_rationals():
    """Exact pairs, noise in the first state alone: the error of the others is in the region."""
    for seed in range(12):
        gen = np.random.default_rng([93, seed])
        kappa = 10.0 ** gen.integers(0, 10)
        z = gen.standard_normal((300, 3))
        z[:, 2] = z[:, 0] + z[:, 2] / kappa
        Theta = np.round(gen.standard_normal((2, 3)), 3)
        exact = [[sum(Fraction(t) * Fraction(v) for t, v in zip(row, one, strict=True))
                  for row in Theta] for one in z]  # fmt: skip
        y = np.array([[float(v) for v in row] for row in exact])
        y[:, 0] += gen.standard_normal(300)
        data = se.Trajectories.from_pairs(z[:, :2], z[:, 2:], y)
        model = se.identify(data, checks=False, noise=se.Noise(design="independent"))
        region = model.region(DELTA, components=True)
        # the error of the second state at a z, in rationals, within what the region says
        for _ in range(20):
            point = gen.standard_normal(3)
            found = np.hstack([model.A, model.B])[1]
            error = sum(
                (Fraction(h) - Fraction(t)) * Fraction(v)
                for h, t, v in zip(found, Theta[1], point, strict=True)
            )
            assert abs(error) <= region.component_bounds(point[:2], point[2:])[1] < 1e-9 * kappa


def test_residual_tests_of_singular_noise_have_their_level_and_never_raise():
    """Of the combinations that are not tied: the same p-values whatever the units."""

    def fires(gen):
        _, _, data = pairs(gen, "one_force", UNITS, N=24)
        checks = se.identify(data, noise=se.Noise(design="independent")).check(19, rng=gen)
        return [p <= 0.0501 for p in checks.p_values.values()]

    exactly(failures(fires, 200, 94), 200)
    for noise in ("one_force", "some_states"):
        found = []
        for units in (None, UNITS):
            data = pairs(np.random.default_rng(95), noise, units)[2]
            found.append(
                list(
                    se.identify(data, noise=se.Noise(design="independent")).checks.p_values.values()
                )
            )
        np.testing.assert_allclose(*found, atol=0.0041)


def test_a_declared_row_of_the_state_matrix_gives_no_warning():
    """x[0] follows x[1] without noise, which `known` says."""
    warned = 0
    for seed in range(60):
        gen = np.random.default_rng([96, seed])
        A, B = np.array([[1.0, 0.1], [-0.3, 0.8]]), np.array([[0.0], [1.0]])
        x, u = [np.zeros(2)], gen.standard_normal((60, 1))
        for acting in u:
            x.append(A @ x[-1] + B @ acting + [0.0, 0.1] * gen.standard_normal(2))
        data = se.Trajectories(np.array(x), u)
        known = [[1.0, 0.1], [np.nan, np.nan]]
        model = se.identify(data, known=(known, [[0.0], [np.nan]]))
        warned += bool(model.warnings)
        assert model.region(DELTA).contains(A, B)
        doubts = se.identify(data, known=(known, None), checks=False).doubts
        assert not any("residual" in text and "declare exact" in text for text in doubts)
        assert "x[0] has no residual" in se.identify(data, checks=False).doubts[0]
    at_most(warned, 60, 0.02)
