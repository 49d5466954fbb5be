"""Points of rest with an intercept or at a set point, invariant sets, and noise of unknown size."""

from __future__ import annotations

import numpy as np
import pytest

import stochens_rs as se
from core_regions import white
from coverage_study import at_most, sets
from declarations import opts
from stochens_rs._base.names import Labels
from stochens_rs.exceptions import InputError
from stochens_rs.feedback import Rest
from stochens_rs.feedback.certificate import noise_bound
from test_feedback import CENTRE, K, S, V, judged

A, B = np.array([[1.1, 0.2], [-0.3, 0.9]]), np.array([[0.0], [1.0]])
SHIFT = np.array([0.2, -0.1])


def of_data(gen, *, N=60, sigma=0.05, intercept=False, declared=True, bound=1.0, **options):
    x, u = gen.standard_normal((N, 2)), gen.standard_normal((N, 1))
    y = x @ A.T + u @ B.T + sigma * gen.standard_normal((N, 2)) + intercept * SHIFT
    known = {"sigma": bound * sigma} if declared else {"design": "independent"}
    data = se.Trajectories.from_pairs(x, u, y)
    return se.identify(data, **opts(intercept=intercept, checks=False, **known, **options))


def rows_at_rest(centre, V, S, rho, K, xs, us, r):
    """The formula, with a residual r of the centre."""
    n = len(centre)
    J, z, D, W = (
        np.vstack([np.eye(n), K]),
        np.concatenate([xs, us]),
        np.linalg.cholesky(S),
        white(V),
    )
    E, M = W @ J, np.linalg.inv(np.eye(n) - centre @ J)
    g = np.linalg.norm(E @ M @ D, 2)
    size = rho * (np.linalg.norm(W @ z) + np.linalg.norm(E @ M @ r)) / (1 - rho * g)
    return np.abs(M @ r) + np.linalg.norm(M @ D, axis=1) * size


def test_the_point_of_rest_of_two_states():
    xs, us = np.array([1.0, 0.0]), np.array([0.1])
    assert np.linalg.norm(white(V) @ [1, 0, 0.1]) == pytest.approx(0.102081035934)
    known = [0.542900277334, 0.027484951937]
    alone = rows_at_rest(CENTRE, V, S, 0.5, K, xs, us, np.zeros(2))
    np.testing.assert_allclose(alone, known, rtol=1e-9)
    found, radius = judged(CENTRE, V, S, 0.5, K).rest(xs, us)
    r = CENTRE @ [1, 0, 0.1] - xs
    expected = rows_at_rest(CENTRE, V, S, 0.5, K, xs, us, r)
    np.testing.assert_allclose(found[:2], expected, rtol=1e-5)
    assert (found[:2] >= expected).all()
    assert found.max() < radius <= np.hypot(*found[:2]) * (1 + 1e-12)


def test_the_invariant_set_of_bounded_noise():
    """The least half axis over the rate and the multiplier, which no grid gets below."""
    loop, least = judged(CENTRE, V, S, 0.5, K), np.inf
    for lam in (0.93, 0.935, 0.935533, 0.936, 0.94):
        for alpha in np.geomspace(0.03, 30.0, 200):
            root = loop.invariant(0.01 * np.eye(2) / (1 - lam), alpha, lam, 0.0)
            least = min(least, np.inf if root is None else np.linalg.norm(root[0]))
    assert least == pytest.approx(1.5998309671, rel=1e-4)
    assert least >= 1.5998309671 * (1 - 1e-7)


@pytest.mark.parametrize("intercept", [False, True])
def test_loops_rest_where_it_is_said_and_get_there_in_the_tube(intercept):
    """All systems drawn on the edge of the region, and the true one."""
    gen, xs, x0 = np.random.default_rng(1), np.array([0.5, 0.1]), np.array([-1.0, 1.0])
    missed, ratios, count = 0, [], sets(20, 8)
    for _ in range(count):
        model = of_data(gen, N=150, intercept=intercept)
        proof = se.gain(model, 1.0, 0.1).certificate(0.1)
        rest = proof.rest(xs)
        tube = proof.tube(x0, 30, rest=rest)
        assert np.isfinite(tube.later).all()
        part, C = proof.region.parts[0], proof.region.centre
        members = [np.hstack([A, B, SHIFT[:, None]])[:, : C.shape[1]]]
        for _ in range(sets(30, 10)):
            G = gen.standard_normal((2, len(part.white)))
            U, _, Vt = np.linalg.svd(G, full_matrices=False)
            members.append(C + np.sqrt(part.factor) * 0.05 * U @ Vt @ part.white)
        for number, Theta in enumerate(members):
            if number == 0 and not proof.region.contains(
                *np.split(Theta, [2, 3], axis=1)[:2], *Theta[:, 3:].T
            ):
                missed += 1
                continue
            x, outside = x0, []
            one = np.ones(C.shape[1] - 3)
            point = np.linalg.solve(
                np.eye(2) - Theta[:, :2] - Theta[:, 2:3] @ proof.K,
                Theta[:, 2:3] @ (rest.inputs - proof.K @ xs) + Theta[:, 3:] @ one,
            )
            off = point - xs
            assert (np.abs(off) <= rest.components).all()
            assert np.linalg.norm(off) <= rest.radius
            assert np.abs(proof.K @ off) <= rest.input_components
            for k in range(120):
                u = rest.inputs + proof.K @ (x - xs)
                if k <= 30:
                    assert (np.abs(x - tube.states[k]) <= tube.components[k] + 1e-12).all()
                    assert np.linalg.norm(x - tube.states[k]) <= tube.radii[k] + 1e-12
                if k < len(tube.later):
                    assert np.linalg.norm(x - point) <= tube.later[k]
                assert (np.abs(np.concatenate([x, u])) <= tube.reach).all()
                x = Theta @ np.concatenate([x, u, one])
                outside.append(np.linalg.norm(off))
            ratios.append(rest.radius / max(outside))
    at_most(missed, count, 0.1)
    assert min(ratios) < 3.0  # no more than needed


def test_the_loop_without_its_rest_leaves_the_tube():
    """The anti-test: a tube about the origin does not hold what is at rest elsewhere."""
    gen = np.random.default_rng(2)
    proof = se.gain(of_data(gen, N=150, intercept=True), 1.0, 0.1).certificate(0.1)
    alone = proof.tube([0.0, 0.0], 20)
    assert not np.isfinite(alone.later).any()
    rest = proof.rest()
    assert proof.tube([0.0, 0.0], 20, rest=rest).settles(0.5) is not None
    x = np.zeros(2)
    for _ in range(60):
        x = A @ x + B @ (rest.inputs + proof.K @ x) + SHIFT
    assert np.linalg.norm(x) > 0.02
    assert np.linalg.norm(x) <= rest.radius
    with pytest.raises(InputError, match="`inputs` must be left out"):
        proof.tube([0.0, 0.0], 20, rest=rest, inputs=[[1.0]])
    other = se.gain(of_data(gen, N=150, intercept=True), 1.0, 0.1).certificate(0.1)
    with pytest.raises(InputError, match="`rest` must be of this certificate"):
        proof.tube([0.0, 0.0], 20, rest=other.rest())
    with pytest.raises(InputError, match="`xs`"):
        proof.rest([1.0])
    assert "every system rests within" in repr(rest)


def test_noise_of_unknown_covariance():
    """One noisy run of each data set: 10 % for the region, 10 % for noise and its size."""
    gen, misses, finite, count = np.random.default_rng(3), 0, 0, sets(120, 40)
    for _ in range(count):
        proof = se.gain(of_data(gen, N=40, declared=False), 1.0, 0.1).certificate(0.1)
        assert proof.region.noise is None
        tube = proof.tube([1.0, -1.0], 20, noise=0.1)
        finite += bool(np.isfinite(tube.radii).all())
        x, out = np.array([1.0, -1.0]), False
        for k in range(21):
            out |= bool((np.abs(x - tube.states[k]) > tube.components[k] + 1e-12).any())
            x = A @ x + B @ (proof.K @ x) + 0.05 * gen.standard_normal(2)
        misses += out
    assert finite >= 0.8 * count
    at_most(misses, count, 0.2)


def test_the_covariance_is_bounded_as_often_as_said():
    """S / a >= Sigma but with the probability given away, 10 %."""
    gen, over, count = np.random.default_rng(4), 0, sets(400, 120)
    for _ in range(count):
        proof = se.gain(of_data(gen, N=20, declared=False), 1.0, 0.1).certificate(0.1)
        covariance, left = noise_bound(proof, "noise", 0.2)
        assert left == 0.1
        over += np.linalg.eigvalsh(covariance)[0] < 0.05**2
    at_most(over, count, 0.1)
    assert over > count / 40  # and not much more seldom


def test_noise_without_a_gaussian_law_has_no_tube():
    gen = np.random.default_rng(5)
    for law in ("sub-gaussian", "bounded"):
        proof = se.gain(of_data(gen, noise=law, bound=4.0), 1.0, 0.1).certificate(0.1)
        with pytest.raises(InputError, match="`noise` needs a bound"):
            proof.tube([1.0, 0.0], 5, noise=0.05)


def test_a_point_of_rest_names_its_states():
    labels = Labels(("encoder [deg]", "camera"), ("motor",), (("camera", "mm"),))
    sizes = (np.array(one) for one in ([-0.02, 3.0], [0.0], [0.1, 0.1], [0.0]))
    rest = Rest(*sizes, 0.149, 0.05, labels)
    assert repr(rest) == (
        "<Rest: every system rests within 0.149 of encoder [deg] = -0.02, camera [mm] = 3, 95 %>"
    )


def test_an_offset_of_states_is_refused_with_its_cure():
    model = of_data(np.random.default_rng(1), N=150)
    with pytest.raises(InputError, match=r"`offset_free` must be left out .* outputs="):
        se.regulate(se.gain(model, 1.0, 0.1), limits=(-1.0, 1.0), offset_free=True)
