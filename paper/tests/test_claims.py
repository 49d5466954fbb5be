"""The checked statements of the paper: every verdict has evidence, and the evidence can fail."""

from __future__ import annotations

import json
import os
import re
import runpy
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pytest

import paper
import stochens_rs as se
from claim_mutants import MUTANTS, ROWS, Patch
from paper import rationals as exact
from paper.verdicts import algorithm_1 as streams
from paper.verdicts import definitions, tails
from paper.verdicts import lemmas_on_tails as tail_bounds
from paper.verdicts import lemmas_on_weights as weights
from paper.verdicts.comparison import compare
from paper.verdicts.printed_figures import section_5
from paper.verdicts.records import statements
from stochens_rs import reference
from stochens_rs.rng import as_key
from stochens_rs.theory import moments

ROOT = Path(__file__).resolve().parents[2]
Claimed: TypeAlias = "tuple[paper.Claims, list[tuple[int, int | None]]]"
SOAK = pytest.mark.skipif("SOAK" not in os.environ, reason="make soak: seconds each")
FALSE = {
    "Contribution vi",
    "Lemma 3.1",
    "Remark after Lemma 3.1",
    "Lemma 3.2",
    "Remark after Lemma 3.2, reachable",
    "Remark after Lemma 3.2, any sequence",
    "Lemma 4.3",
    "Lemma 4.4",
    "Algorithm 1",
    "Lemma 4.5, recursion",
    "Lemma 4.5, second inequality",
}


@pytest.fixture
def found(claimed: Claimed) -> paper.Claims:
    return claimed[0]


def test_every_statement_has_its_row_and_its_evidence(found: paper.Claims) -> None:
    assert {row.item for row in found.rows if row.verdict == "false"} == FALSE
    assert [row.item for row in found.rows] == statements().sections()
    for row in found.rows:
        assert row.evidence
        texts = {f"evidence {k}" for k, _ in enumerate(row.evidence, start=1)}
        assert set(statements()[row.item]) - {"true"} == {"says", "verdict", *texts}
        assert row.verdict in ("holds", "holds with a correction", "false")
        assert (row.corrected == "") == (row.verdict == "holds")


def test_the_evidence_supports_every_verdict(found: paper.Claims) -> None:
    assert [row.item for row in found.rows if not row.confirmed] == []
    assert found.confirmed


def test_progress_counts_the_statements(claimed: Claimed) -> None:
    found, seen = claimed
    assert seen == [(k, len(found.rows)) for k in range(1, len(found.rows) + 1)]


@SOAK
def test_executors_and_files_change_nothing(found: paper.Claims, tmp_path: Path) -> None:
    whole, folder = found.to_dict(), tmp_path / "made"

    def stop(done: int, _: int | None) -> None:
        if done == 28:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        paper.claims(quick=True, path=folder, progress=stop)
    before = {path.name: path.read_bytes() for path in folder.glob("*.study")}
    assert set(before) == {
        f"{k}.study" for k in ("algorithm-1", "comparison", "one-step", "power", "tails")
    }
    with ThreadPoolExecutor(2) as threads:
        again = paper.claims(quick=True, path=folder, executor=threads)
    assert again.to_dict() == whole
    assert before.items() <= {p.name: p.read_bytes() for p in folder.glob("*.study")}.items()
    with pytest.raises(se.exceptions.StateError, match="`key` of"):
        paper.claims(2, quick=True, path=folder)


@SOAK
def test_another_seed_gives_the_same_verdicts() -> None:
    # the Monte Carlo parts decide at 4 standard errors or at margins of factors
    key = as_key(12345)
    measured = tails.measure(key, runs=1000)
    compared = compare(np.array([2.0, 1.0, 1.0]), key, 300, 300)
    streamed = streams.measure(key)
    rows = [
        definitions.approximate_reachability(key),
        definitions.sample_reachability(key),
        tail_bounds.lemma_42(measured),
        tail_bounds.lemma_43(key),
        weights.exact_recovery(key),
        weights.first_inequality(key),
        weights.second_inequality(compared),
        streams.variance(streamed),
        streams.algorithm_1(streamed),
        *(row() for row in section_5(key, 4, 300)),
    ]
    assert [row.item for row in rows if not row.confirmed] == []


def test_it_can_be_printed_and_stored(found: paper.Claims) -> None:
    text = str(found)
    assert all(item in text for item in ROWS)
    assert "CONTRARY" not in text
    assert max(map(len, text.splitlines())) <= 96
    data = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert data["confirmed"] is True
    assert len(data["claims"]) == len(ROWS)
    assert "5/32" in str(found["Lemma 4.5, second inequality"].evidence)
    with pytest.raises(KeyError):
        found["Lemma 9.9"]


def test_what_is_called_exact_is_rational(found: paper.Claims) -> None:
    assert "squared error 1/5, uniform weights at 0." in str(found["Lemma 4.5, second inequality"])
    first, second = (one.text for one in found["Lemma 4.4"].evidence)
    assert "sum to 7 and give ||S y - w||^2 = 900, the corrected 0." in first
    assert "the printed minimum is 1, that of weights on the simplex 2." in second
    # hitting every entry of a matrix is not enough
    assert "weights on the simplex is 1." in found["Remark after Lemma 4.4"].evidence[0].text


def test_the_library_gives_the_numbers_of_lemmas_44_and_45() -> None:
    def square(samples: list[list[float]], target: list[float], method: str = "alse") -> float:
        ensemble = se.Ensemble.from_samples(np.array(samples, dtype=float))
        return se.fuse(ensemble, method, target=np.array(target, dtype=float)).error ** 2

    assert square([[7, 0], [0, 7]], [3, 4]) < 1e-24
    assert square([[2, 0]], [1, 1]) == pytest.approx(2.0, rel=1e-9)
    three = [[[0, 0], [3, 3]], [[3, 0], [0, 3]], [[0, 3], [3, 0]]]
    A = [[1, 1], [2, 2]]
    assert square(three, A, "uniform") < 1e-24
    assert square(three, A, "slse") == pytest.approx(1 / 5, rel=1e-9)
    assert square(three, A, "slse-safeguarded") < 1e-20
    assert square(three, A) < 1e-20


def test_the_figure_is_drawn(found: paper.Claims) -> None:
    pytest.importorskip("matplotlib")
    left, right, share = found.plot().axes
    assert len(left.get_lines()) == 3
    assert "Hadamard" in left.get_title(loc="left")
    assert len(right.get_lines()) == 3
    labels = [line.get_label() for line in left.get_lines()]
    assert labels[0] == "simulated bound (holds)"
    assert found.tails.bounds == ("simulated",) * len(found.tails.sizes)
    bars = sorted((bar.get_x(), bar.get_x() + bar.get_width()) for bar in share.patches)
    assert len(bars) > 20
    assert all(before[1] < after[0] for before, after in pairwise(bars))


def test_the_row_of_the_figure_names_the_bound_that_is_drawn(found: se.Claims) -> None:
    row = found["Lemma 4.2"]
    assert "the simulated bound in at most" in row.evidence[1].text
    assert "Sharper, among formulas: P(" in row.corrected


def test_page_of_claims_has_every_statement(claimed: Claimed) -> None:
    names = runpy.run_path(str(ROOT / "docs" / "theory" / "_claims.py"))
    claims = claimed[0]
    text = names["page"](claims)
    assert text == names["page"](claims)
    for k, row in enumerate(claims.rows, start=1):
        assert f"](#claim-{k}) | {row.verdict} |" in text
        assert (
            f"(claim-{k})=\n## {names['readable'](row.item)}\n\n**{row.verdict.capitalize()}"
            in text
        )
        assert all(names["readable"](one.text) in text for one in row.evidence)
    assert len(re.findall(r"^## ", text, re.M)) == len(claims.rows)


# -- the evidence could be contrary ----------------------------------------------------------------


def test_no_evidence_is_without_a_mutant(found: paper.Claims) -> None:
    assert [row.item for row in found.rows] == list(ROWS)
    evidence = [(row.item, k) for row in found.rows for k in range(len(row.evidence))]
    assert evidence == list(MUTANTS)
    assert all(MUTANTS.values())


def test_unchanged_the_small_rows_are_confirmed() -> None:
    rows = {item: build() for item, build in ROWS.items()}
    assert [item for item, row in rows.items() if not row.confirmed or row.item != item] == []


@pytest.mark.parametrize(
    ("item", "index", "mutant"),
    [
        pytest.param(item, k, mutant, id=f"{item} [{k}] {name}")
        for (item, k), mutants in MUTANTS.items()
        for name, mutant in mutants.items()
    ],
)
def test_the_evidence_fails(item: str, index: int, mutant: Patch) -> None:
    assert not changed(item, mutant).evidence[index].confirms


@cache
def changed(item: str, mutant: Patch) -> paper.Claim:
    """The row with this mutant, which may be that of several evidences."""
    with pytest.MonkeyPatch.context() as patch:
        mutant(patch)
        return ROWS[item]()


# -- what the evidence is computed with -----------------------------------------------------------


def test_exact_realizations() -> None:
    w = exact.array([3, -1, 0, 2])
    masses = exact.atoms(w)
    assert sum(p for p, _ in masses) == 1
    assert np.array_equal(sum(p * atom for p, atom in masses), w)
    [(p, zero)] = exact.atoms(exact.array([0, 0]))
    assert p == 1
    assert not zero.any()
    A = exact.array([[1, 0], [-2, 3]])
    for law, count in ((exact.matrix_atoms(A), 2), (exact.row_atoms(A), 2)):
        assert len(law) == count
        assert np.array_equal(sum(p * one for p, one in law), A)


def test_nothing_exact_becomes_a_float() -> None:
    w = exact.array([3, -1, 0, 2])
    for _, samples in exact.sequences(w, 2):
        for x in (*samples, exact.mean(samples), exact.alse(samples, w), exact.slse(samples, w)):
            assert {type(entry) for entry in x} == {Fraction}
    assert type(exact.square(0 * w)) is type(exact.weight(w, w, w)) is Fraction


def test_exact_slse_is_the_references() -> None:
    gen = np.random.default_rng(0)
    samples = exact.array(gen.integers(-5, 6, (12, 3)))
    target = exact.array([1, -2, 1])
    errors = reference.fusing.slse(exact.floats(samples), exact.floats(target)).errors
    assert np.allclose(errors**2, exact.floats(exact.slse(samples, target)), atol=1e-12)


def test_the_numbers_of_the_enumeration() -> None:
    w = exact.array([2, 1, 1])
    third = sum(p * exact.slse(s, w)[-1] for p, s in exact.sequences(w, 3))
    assert third == Fraction(4073, 1568)
    cases = [[0, 0, 1, 2], [0, 1, 2, 0]]
    atoms = exact.array(4 * np.eye(3, dtype=int))
    ends = [exact.slse(atoms[case], w)[-1] for case in cases]
    assert ends == [Fraction(3, 98), Fraction(75, 7154)]


def test_exact_norms_and_weights_are_numpys() -> None:
    gen = np.random.default_rng(1)
    for _ in range(50):
        M = gen.integers(-4, 5, (2, 2))
        norm = float(np.linalg.norm(M, 2))
        above, below = (Fraction(norm**2 + 1e-6 * sign) for sign in (1, -1))
        assert exact.spectral_at_most(exact.array(M), above)
        assert norm == 0.0 or not exact.spectral_at_most(exact.array(M), below)
    w = exact.array([3, -1, 0, 2])
    for _, samples in exact.sequences(w, 3):
        ensemble = se.Ensemble.from_samples(exact.floats(samples))
        fit = se.fuse(ensemble, "alse", target=exact.floats(w))
        assert np.allclose(fit.estimate, exact.floats(exact.alse(samples, w)), atol=1e-9)


def test_simulated_drift_has_the_exact_mean_square() -> None:
    # 20 000 runs: the relative standard error of the mean square is below 1.2 %; 5 % is 4 of them
    gen = np.random.default_rng(3)
    A, x0 = gen.standard_normal((5, 5)), np.array([1.0, -2.0, 0.5, 0.0, 1.0])
    errors = tails.drift_errors(A, x0, 30, 20_000, gen)
    exact_rms = moments.state_rms((A, np.eye(5)), x0, np.zeros(5), 30, fusion="diagonal")
    assert np.mean(errors**2) == pytest.approx(exact_rms**2, rel=0.05)
    product = moments.state_rms((A, np.eye(5)), x0, np.zeros(5), 30)
    assert np.mean(errors**2) != pytest.approx(
        product**2, rel=0.2
    )  # the other fusion is told apart


def test_hadamard() -> None:
    H = tails.hadamard(16)
    assert np.array_equal(H @ H.T, 16 * np.eye(16))
