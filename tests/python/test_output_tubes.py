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
        ball(H, V, S, m=len(V) - len(S)), given(system), x0, PLAN, gain, None
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
    found = _core.output_tube(ball(H, V, S, m=len(V) - len(S)), given(system), x0, PLAN, None, None)
    radii = [0.8366078308032, 1.331646430618, 1.680074075288, 2.033081252725]
    np.testing.assert_allclose(found[2][0][1:], radii, rtol=1e-8)


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
