"""The tube of outputs of window models: oracles, a twin, coverage."""

from __future__ import annotations

import numpy as np
import pytest

from core_regions import ball
from stochens_rs import _core
from twin import outputs as twin

T = np.arange(60)
U = (((3 * T**2 + 2 * T) % 7 - 3) / 3.0)[:, None]
W = ((np.arange(61) + 2) ** 2 % 11 - 5) / 20.0


def logged():
    y = np.zeros((61, 1))
    y[0], y[1] = 0.3, -0.2
    for t in range(1, 60):
        y[t + 1] = 1.2 * y[t] - 0.5 * y[t - 1] + U[t] + 0.4 * U[t - 1] + W[t + 1]
    return y


Y = logged()
PLAN = np.array([[0.5], [-0.3], [0.0], [0.2]])
K = np.array([[-0.4, 0.2, -0.1]])


def given(system):
    matrix, J, G = (np.ascontiguousarray(one) for one in system)
    return matrix, J, G, J.shape[1] - len(matrix)


def lagged():
    """The second part of the data, with the sum of squares that the first part leaves to it."""
    z, after = twin.lag_rows(Y, np.vstack([U, [[0.0]]]), 2)
    H, V, _ = twin.fitted(z[16:], after[16:])
    return H, V, np.array([[2.030613955846]])


def filtered():
    z, after = twin.filter_rows(Y, np.vstack([U, [[0.0]]]), 0.5, 2, 5)
    H, V, _ = twin.fitted(z[13:], after[13:])
    return H, V, np.array([[8.800619103803]])


@pytest.mark.parametrize(
    ("gain", "radii"),
    [
        (None, [0.2241870811421, 0.4365479248427, 0.5869518079391, 0.7345609493601]),
        (K, [0.2241870811421, 0.3702078819506, 0.4492641437536, 0.4978106605001]),
    ],
)
def test_lags(gain, radii):
    H, V, S = lagged()
    system = twin.lag_system(H, 2, 1)
    x0 = np.array([1.0, 0.8, 0.5])
    states, predicted, (tube, components), none = _core.output_tube(
        ball(H, V, S, m=len(V) - len(S)), given(system), x0, PLAN, gain, None, None
    )
    means = [1.538870608147, 1.253777442539, 0.634686220201, 0.3725671434229]
    np.testing.assert_allclose(predicted[:, 0], means, rtol=1e-10)
    np.testing.assert_allclose(states[1:, 0], means, rtol=1e-10)
    np.testing.assert_allclose(tube, [0.0, *radii], rtol=1e-8)
    np.testing.assert_allclose(components[:, 0], tube, rtol=1e-8)  # one output
    assert none is None


def test_filters():
    H, V, S = filtered()
    system = twin.filter_system(H, 0.5, 2, 1)
    x0 = np.array([1.0, 0.8, 0.5, 0.4])
    found = _core.output_tube(
        ball(H, V, S, m=len(V) - len(S)), given(system), x0, PLAN, None, None, None
    )
    radii = [0.8366078308032, 1.331646430618, 1.680074075288, 2.033081252725]
    np.testing.assert_allclose(found[2][0][1:], radii, rtol=1e-8)


@pytest.mark.parametrize("gain", [None, K])
def test_inputs_that_may_be_off_the_plan(gain):
    """The largest error of 2000 members with the worst signs; exact where the region is a point."""
    H, V, S = lagged()
    system, x0 = twin.lag_system(H, 2, 1), np.array([1.0, 0.8, 0.5])
    phi, rng = np.array([[0.3], [0.0], [0.2], [0.1]]), np.random.default_rng(1)

    def tube(size, apart):
        region = ball(H, V, size * S, m=len(V) - len(S))
        return _core.output_tube(region, given(system), x0, PLAN, gain, None, apart)

    def outputs(Theta, off, planned):
        x, found = x0, []
        for k in range(len(PLAN)):
            u = PLAN[k] + off[k] + (0.0 if gain is None else gain @ (x - planned[k]))
            y = Theta @ np.r_[x[:2], u, x[2:]]
            found.append(y)
            x = np.r_[y, x[:1], u]
        return np.array(found)

    states, predicted, (radii, _), _ = tube(1.0, phi)
    root, signs = np.linalg.inv(np.linalg.cholesky(V)).T, rng.choice([-1.0, 1.0], (2000, 4, 1))
    most = np.zeros(4)
    for sign in signs:
        g = rng.standard_normal((1, 4))
        Theta = H + np.sqrt(S) * g / np.linalg.norm(g) @ root.T
        off = np.abs(outputs(Theta, sign * phi, states) - predicted)[:, 0]
        most = np.maximum(most, off)
    assert (most <= radii[1:]).all()
    assert (most > 0.3 * radii[1:]).all()
    assert (most > tube(1.0, None)[2][0][1:]).any()  # without what inputs are off
    # a point: the sum of |C A^j B| phi
    exact = tube(1e-24, phi)[2][0][1:]
    units = [outputs(H, e, states) - predicted for e in np.eye(4)[:, :, None]]
    np.testing.assert_allclose(exact, np.abs(np.hstack(units)) @ phi[:, 0], rtol=1e-8)


def test_the_small_gain_number_of_a_loop():
    H, V, S = lagged()
    region, noise = _core.entered_region(
        ball(H, V, S, m=len(V) - len(S)), given(twin.lag_system(H, 2, 1)), None
    )
    loop = _core.Feedback(region, K)
    norm, least, _ = loop.sizes
    assert noise is None
    assert loop.status == "certified"
    assert least <= 0.6141587440744 * (1.0 + 1e-6)
    assert 0.6141587440744 <= norm < 0.6141587440744 * 1.002
