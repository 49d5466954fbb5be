"""The checked statements of the paper: every verdict is supported, and could fail to be."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs import reference
from stochens_rs.rng import as_key
from stochens_rs.theory import bounds, moments
from stochens_rs.verdicts import _definitions as definitions
from stochens_rs.verdicts import _exact as exact
from stochens_rs.verdicts import _sampling as sampling
from stochens_rs.verdicts import _weights as weights
from stochens_rs.verdicts import tails
from stochens_rs.verdicts.comparison import compare

ITEMS = [
    "Definition 2.1, eq. (3)",
    "Definition 2.2",
    "Definition 2.3",
    "Definition 2.4",
    "Lemma 3.1",
    "Lemma 3.2",
    "Lemma 4.1",
    "Lemma 4.2",
    "Lemma 4.3",
    "Lemma 4.4",
    "Remark after Lemma 4.4",
    "Algorithm 1",
    "Lemma 4.5, first inequality",
    "Lemma 4.5, second inequality",
    "Figure 1",
    "Figure 2",
    "Figure 3",
]
FALSE = {"Lemma 3.1", "Lemma 3.2", "Lemma 4.3", "Lemma 4.4", "Algorithm 1"}


@pytest.fixture(scope="module")
def found() -> se.Claims:
    return se.claims(quick=True)


def test_every_statement_has_its_row_and_its_evidence(found: se.Claims) -> None:
    assert [row.item for row in found.rows] == ITEMS
    assert {row.item for row in found.rows if row.verdict == "false"} == {
        *FALSE,
        "Lemma 4.5, second inequality",
    }
    for row in found.rows:
        assert row.evidence
        assert (row.corrected == "") == (row.verdict == "holds")


def test_the_evidence_supports_every_verdict(found: se.Claims) -> None:
    assert [row.item for row in found.rows if not row.confirmed] == []
    assert found.confirmed


def test_another_seed_gives_the_same_verdicts() -> None:
    # the Monte Carlo parts decide at 4 standard errors or at margins of factors
    key = as_key(12345)
    measured = tails.measure(key, runs=1000)
    compared = compare(np.array([2.0, 1.0, 1.0]), key, 300, 300)
    rows = [
        definitions.approximate_reachability(key),
        definitions.sample_reachability(key),
        sampling.lemma_42(measured),
        sampling.lemma_43(key),
        weights.exact_recovery(key),
        weights.first_inequality(key),
        weights.second_inequality(compared),
    ]
    assert [row.item for row in rows if not row.confirmed] == []


def test_it_can_be_printed_and_stored(found: se.Claims) -> None:
    text = str(found)
    assert all(item in text for item in ITEMS)
    assert "CONTRARY" not in text
    assert max(map(len, text.splitlines())) <= 96
    data = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert data["confirmed"] is True
    assert len(data["claims"]) == len(ITEMS)
    assert "5/32" in str(found["Lemma 4.5, second inequality"].evidence)
    with pytest.raises(KeyError):
        found["Lemma 9.9"]


def test_what_is_called_exact_is_rational(found: se.Claims) -> None:
    assert "squared error 1/5, uniform weights at 0." in str(found["Lemma 4.5, second inequality"])
    first, second = (one.text for one in found["Lemma 4.4"].evidence)
    assert "sum to 7 and give ||S y - w||^2 = 900, the corrected 0." in first
    assert "the printed minimum is 1, that of weights on the simplex 2." in second
    # hitting every entry of a matrix is not enough
    assert "weights on the simplex is 1." in found["Remark after Lemma 4.4"].evidence[0].text


def test_the_corrected_lemma_is_checked_too() -> None:
    measured = tails.measure(as_key(1), n=8, runs=300)
    assert sampling.lemma_42(measured).evidence[2].confirms
    above = replace(measured, empirical=100.0 * measured.empirical)
    assert not sampling.lemma_42(above).evidence[2].confirms


def test_the_figure_is_drawn(found: se.Claims) -> None:
    pytest.importorskip("matplotlib")
    left, right, _ = found.plot().axes
    assert len(left.get_lines()) == 3
    assert "Hadamard" in left.get_title(loc="left")
    assert len(right.get_lines()) == 3


# -- the evidence could be contrary ----------------------------------------------------------------


def test_a_true_lemma_would_not_be_called_false(monkeypatch: pytest.MonkeyPatch) -> None:
    compared = compare(np.array([2.0, 1.0, 1.0]), as_key(1), 50, 50)
    assert weights.second_inequality(compared).confirmed
    with monkeypatch.context() as patch:
        # were SLSE the better of itself and the mean, the inequality would hold
        honest = exact.slse
        patch.setattr(
            exact,
            "slse",
            lambda samples, w: [
                min(e, exact.distance(exact.mean(samples[: k + 1]), w))
                for k, e in enumerate(honest(samples, w))
            ],
        )
        assert not weights.second_inequality(compared).confirmed
    with monkeypatch.context() as patch:
        patch.setattr(exact, "matrix_atoms", lambda A: [(Fraction(1), A)])  # no randomness
        assert not definitions.index_maps().confirmed
    with monkeypatch.context() as patch:
        patch.setattr(bounds.paper, "OneVector", lambda w, C: bounds.McDiarmid(w))
        assert not sampling.lemma_42(tails.measure(as_key(1), n=8, runs=200)).confirmed


def test_a_bound_that_fails_is_noticed() -> None:
    measured = tails.measure(as_key(1), n=16, runs=500)
    broken = replace(measured, failures=measured.failures[:, ::-1])
    assert not sampling.lemma_42(broken).confirmed


def test_slse_above_the_mean_square_bound_is_noticed() -> None:
    compared = compare(np.array([2.0, 1.0, 1.0]), as_key(1), 200, 50)
    assert not weights.second_inequality(replace(compared, slse=3.0 * compared.slse)).confirmed


# -- what the evidence is computed with -----------------------------------------------------------


def test_exact_realizations() -> None:
    w = exact.vector(3, -1, 0, 2)
    masses = exact.atoms(w)
    assert sum(p for p, _ in masses) == 1
    mean = exact.vector(0, 0, 0, 0)
    for p, atom in masses:
        mean = exact.combine(exact.ONE, mean, p, atom)
    assert mean == w
    assert exact.atoms(exact.vector(0, 0)) == [(1, exact.vector(0, 0))]
    A = (exact.vector(1, 0), exact.vector(-2, 0))
    assert len(exact.matrix_atoms(A)) == 2


def test_exact_slse_is_the_references() -> None:
    gen = np.random.default_rng(0)
    samples = [exact.vector(*map(int, gen.integers(-5, 6, 3))) for _ in range(12)]
    target = exact.vector(1, -2, 1)
    floats = np.array(samples, dtype=float)
    errors = reference.slse(floats, np.array(target, dtype=float)).errors
    assert np.allclose(errors**2, np.array(exact.slse(samples, target), dtype=float), atol=1e-12)


def test_the_numbers_of_the_enumeration() -> None:
    w = exact.vector(2, 1, 1)
    third = sum(p * exact.slse(s, w)[-1] for p, s in exact.sequences(w, 3))
    assert third == Fraction(4073, 1568)
    cases = [[0, 0, 1, 2], [0, 1, 2, 0]]
    atoms = [tuple(4 if k == i else 0 for k in range(3)) for i in range(3)]
    ends = [exact.slse([exact.vector(*atoms[i]) for i in case], w)[-1] for case in cases]
    assert ends == [Fraction(3, 98), Fraction(75, 7154)]


def test_simulated_drift_has_the_exact_mean_square() -> None:
    # 20 000 runs: the relative standard error of the mean square is below 1.2 %; 5 % is 4 of them
    gen = np.random.default_rng(3)
    A, x0 = gen.standard_normal((5, 5)), np.array([1.0, -2.0, 0.5, 0.0, 1.0])
    errors = tails.drift_errors(A, x0, 30, 20_000, gen)
    exact_rms = moments.state_rms(np.eye(5), x0, np.zeros(5), A, 30, fusion="diagonal")
    assert np.mean(errors**2) == pytest.approx(exact_rms**2, rel=0.05)
    product = moments.state_rms(np.eye(5), x0, np.zeros(5), A, 30)
    assert np.mean(errors**2) != pytest.approx(
        product**2, rel=0.2
    )  # the other fusion is told apart


def test_hadamard() -> None:
    H = tails.hadamard(16)
    assert np.array_equal(H @ H.T, 16 * np.eye(16))
