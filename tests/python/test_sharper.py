"""Tubes of followed plans and the law of fits with feedback: oracles, proofs by draws, coverage."""

from __future__ import annotations

import numpy as np
import pytest

from twin import sharper as twin


class LoopT:
    """A loop of two states under a gain, and a plan of four steps."""

    def __init__(self):
        model = np.array([[0.9, 0.2, 0.0], [-0.1, 0.8, 1.0]])
        K = np.array([[0.1, -0.5]])
        V = np.array([[115.0, 41.0, -11.0], [41.0, 103.0, -11.0], [-11.0, -11.0, 99.0]])
        W = np.linalg.cholesky(np.linalg.inv(V)).T
        self.A = model[:, :2] + model[:, 2:] @ K
        self.D = np.linalg.cholesky(np.array([[0.45, 0.04], [0.04, 0.06]]))
        self.E = W @ np.vstack([np.eye(2), K])
        x, c = np.array([1.0, -1.0]), []
        for u in (0.5, 0.0, -0.5, 0.25):
            c.append(W @ np.append(x, u))
            x = model @ np.append(x, u)
        self.c = np.array(c)
        self.of = self.A, self.D, self.E


# -- oracles ---------------------------------------------------------------------------------------


def test_oracles_of_the_tube():
    one = LoopT()
    first, second = (twin.X(one.A, one.D, one.c, h, 4) for h in np.eye(2))
    assert np.linalg.norm(first, "nuc") == pytest.approx(0.265341654564, abs=6e-13)
    assert np.linalg.norm(second, "nuc") == pytest.approx(0.036915785092, abs=6e-13)
    assert np.linalg.norm(first) == pytest.approx(0.263764508116, abs=6e-13)
    gains = {
        1.0: [0.066662197173, 0.104298214920, 0.140120407001],
        1.1: [0.060601997430, 0.091218905386, 0.118415409597],
        0.9: [0.074069107971, 0.121397785325, 0.170281336065],
    }
    for t, expected in gains.items():
        assert [twin.gain(*one.of, t, k) for k in (2, 3, 4)] == pytest.approx(expected, abs=6e-13)
    M = twin.gram(twin.maps(*one.of, one.c), 1.0, 4)
    assert np.trace(M) == pytest.approx(9.189118165747e-4, abs=6e-17)
    assert np.linalg.eigvalsh(M)[-1] == pytest.approx(8.570636065488e-4, abs=6e-17)
    assert twin.reach(one.A, one.D, np.eye(2)[0], 1.0, 4) == pytest.approx(
        1.183906115366, abs=6e-13
    )


def test_oracles_of_the_noise():
    one = LoopT()
    Y = twin.lemma2(*one.of, 0.01 * np.eye(2), 1.0, 4, kappa=1.0)[4]
    nominal = twin.lemma2(*one.of, 0.01 * np.eye(2), 1e-30, 4, kappa=1.0)[4]
    assert np.diag(Y) == pytest.approx([0.037842950852, 0.011283804515], abs=6e-13)
    assert np.diag(nominal) == pytest.approx([0.031498970000, 0.010988290000], abs=6e-13)


def test_oracles_of_one_member():
    one, G = LoopT(), np.array([[0.3, -0.2, 0.5], [0.1, 0.4, -0.6]])
    e, e1, e2 = twin.orders(*one.of, one.c, G)
    assert e[4] == pytest.approx([0.102491151127, -0.004875231990], abs=6e-13)
    assert e1[4] == pytest.approx([0.097873458304, -0.005231550543], abs=6e-13)
    assert e2[4, 0] == pytest.approx(0.004514007997, abs=6e-13)
    Q = twin.second_order(*one.of, one.c, np.eye(2)[0], 4)
    g = G.T.ravel()
    assert g @ Q @ g == pytest.approx(0.004514007997, abs=6e-13)
    sizes = np.trace(Q), np.linalg.norm(Q), np.linalg.norm(Q, 2)
    assert sizes == pytest.approx((0.025238462770, 0.028662230711, 0.028237422790), abs=6e-13)
