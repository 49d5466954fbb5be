"""The checker of proofs accepts the true one and no other; its region holds the true system."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from argparse import Namespace
from fractions import Fraction as F
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import most, sets
from stochens_rs.export import check_proof

CSV = Path(__file__).parents[2] / "docs/data/runs.csv"
HOW = Namespace(run="run", noise=None, write_sums=None)
NAMES = {"states": ["position", "angle", "speed", "rate"], "inputs": ["force"]}


@pytest.fixture(scope="module")
def made(tmp_path_factory: Any) -> Any:
    folder = tmp_path_factory.mktemp("proof")
    model = se.identify(se.Trajectories.from_csv(CSV, **NAMES, by="run", time="time"))
    loop = se.gain(model, [1.0, 10.0, 0.1, 1.0], 0.01)
    loop.certificate(0.05).save(folder / "proof.json")
    loop.to_c(folder / "controller.h")
    return folder, loop


def sealed(proof: Any) -> Any:
    text = json.dumps(proof, sort_keys=True)
    return {"proof": proof, "sha256": hashlib.sha256(text.encode()).hexdigest()}


def test_the_true_proof_as_a_user_checks_it(made: Any, tmp_path: Path) -> None:
    """In a process of its own, where the package cannot be imported; then with the sums alone."""
    folder, _ = made
    checker = tmp_path / "check_proof.py"
    checker.write_text(Path(check_proof.__file__).read_text("utf-8"), "utf-8")
    assert len(checker.read_text("utf-8").splitlines()) <= 250
    given = [folder / "proof.json", folder / "controller.h"]
    sums = tmp_path / "sums.json"
    for data in ([CSV, "--run", "run", "--write-sums", sums], [sums]):
        done = subprocess.run(
            [sys.executable, "-I", "-S", str(checker), *map(str, (*given, *data))],
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        assert done.stdout.startswith("proved: u = K x stabilizes every system that 400 pairs")
    other = tmp_path / "runs.csv"
    other.write_text(CSV.read_text("utf-8").replace("0.01378", "0.01379", 1), "utf-8")
    done = subprocess.run(
        [sys.executable, str(checker), *map(str, (*given, other))], capture_output=True, text=True
    )
    assert done.stdout == "not proved: the data are others than those of the header\n"
    assert done.returncode == 1


def test_names_with_units_are_those_of_their_columns(tmp_path: Path) -> None:
    log, header = tmp_path / "runs.csv", tmp_path / "controller.h"
    log.write_text(CSV.read_text("utf-8").replace("angle", "angle [rad]", 1), "utf-8")
    names = {**NAMES, "states": [n.replace("angle", "angle [rad]") for n in NAMES["states"]]}
    model = se.identify(se.Trajectories.from_csv(log, **names, by="run", time="time"))
    loop = se.gain(model, [1.0, 10.0, 0.1, 1.0], 0.01)
    loop.certificate(0.05).save(tmp_path / "proof.json")
    loop.to_c(header)
    proof = json.loads((tmp_path / "proof.json").read_text("utf-8"))
    assert proof["proof"]["states"][1] == "angle [rad]"
    found = check_proof.check(proof, header.read_text("utf-8"), [str(log)], HOW)
    assert found.startswith("proved")


def least_eigenvalue(C: Any, V: Any, fS: Any, K: Any, Q: Any) -> float:
    """The largest least eigenvalue over t of the matrix of the S-lemma, in balanced units."""
    n, d = len(C), len(V)
    J = np.vstack([np.eye(n), K, np.zeros((d - n - len(K), n))])
    own, A0 = J.T @ np.linalg.solve(V, J), C @ J
    values = np.linalg.eigvalsh(Q)
    if values[0] <= 0.0:
        return -1.0
    found = []
    for t in np.geomspace(1e-6, 1e6, 600):
        by = t * np.trace(Q) / np.trace(fS)
        M = np.block([[np.linalg.inv(Q) - own / by, A0.T], [A0, Q - by * fS]])
        scale = np.sqrt(np.abs(np.diag(M)))
        found.append(np.linalg.eigvalsh(M / np.outer(scale, scale))[0])
    return max(found)


def test_mutated_proofs_are_refused(made: Any) -> None:
    """200, 60 in `make test`: half are damaged files; the others are no proofs by a twin."""
    folder, _ = made
    text, header = ((folder / one).read_text("utf-8") for one in ("proof.json", "controller.h"))
    sums = folder / "sums.json"
    how = Namespace(run="run", noise=None, write_sums=str(sums))
    assert check_proof.check(json.loads(text), header, [str(CSV)], how).startswith("proved")
    data, rng, refused = [str(sums)], np.random.default_rng(4), []

    def accepted(tree: Any, head: str = header) -> bool:
        try:
            return check_proof.check(tree, head, data, HOW).startswith("proved")
        except (ValueError, KeyError, TypeError, ArithmeticError, IndexError, AttributeError):
            return False

    assert accepted(json.loads(text))
    for _ in range(sets(100, 30)):
        at = int(rng.integers(len(text)))
        while text[at].isspace():
            at = int(rng.integers(len(text)))
        other = (
            text[:at] + chr(rng.choice([48 + int(rng.integers(10)), 45, 46, 101])) + text[at + 1 :]
        )
        if other == text:
            other = text[:at] + text[at + 1 :]
        try:
            tree = json.loads(other)
        except ValueError:
            refused.append(True)
            continue
        refused.append(tree == json.loads(text) or not accepted(tree))
    true = json.loads(text)["proof"]
    C, V, fS = (
        np.array([[float(v) for v in row] for row in one])
        for one in check_proof.region(json.loads(sums.read_text("utf-8")), 5, F(0.05), [])
    )
    at = header.index("controller_K[4]")
    places = [at + header[at:].index("_R(")]
    K = np.array([float(one.split(")")[0]) for one in header[places[0] :].split("_R(")[1:5]])[None]
    assert least_eigenvalue(C, V, fS, K, np.array(true["Q"])) > 0.0
    kinds = ("names", "delta", "Q", "scale", "K", "shape", "digest")
    for turn in range(sets(100, 30)):
        tree, head, kind = json.loads(text)["proof"], header, kinds[turn % len(kinds)]
        Q = np.array(tree["Q"])
        if kind == "names":
            tree["states"] = list(rng.permutation(tree["states"])) + ["u"] * (turn % 3 == 0)
            tree["offset"] = int(turn % 3 != 0)
        elif kind == "delta":
            tree["delta"] = [0.0, 1.0, -0.1, float("nan"), 1e-200, "x", None][turn % 7]
        elif kind == "Q":  # far enough that a twin says it is no proof
            noise = rng.standard_normal(Q.shape) * np.sqrt(np.outer(np.diag(Q), np.diag(Q)))
            Q = Q + (noise + noise.T) * 0.5
            tree["Q"] = Q.tolist()
            if least_eigenvalue(C, V, fS, K, Q) > 0.0:
                continue
        elif kind == "scale":  # of one state
            unit = np.eye(4)
            unit[rng.integers(4)] *= 10.0 ** rng.choice([-2.0, 2.0])
            Q = unit @ Q @ unit
            tree["Q"] = Q.tolist()
            assert least_eigenvalue(C, V, fS, K, Q) < 0.0
        elif kind == "K":
            factor = rng.choice([-1.0, 0.0, 0.3, 5.0])
            gain = factor * K[0]
            table = ", ".join(f"CONTROLLER_R({float(v)!r})" for v in gain)
            end = header.index("};", at)
            head = header[:at] + "controller_K[4] = {\n    " + table + header[end:]
            assert least_eigenvalue(C, V, fS, gain[None], Q) < 0.0
        elif kind == "shape":
            wrong = [Q[:3], Q[:, :3], np.triu(Q), -Q, 0 * Q, Q * np.nan, Q[0]]
            tree["Q"] = wrong[turn % len(wrong)].tolist()
        else:
            head = header.replace("sha256 ", f"sha256 {turn % 10}", 1)
        refused.append(not accepted(sealed(tree), head))
    assert len(refused) >= sets(190, 55)
    assert all(refused), [k for k, one in enumerate(refused) if not one]


def test_the_bounds_of_exp_and_log_are_outward() -> None:
    for x in (F(0), F(1, 3), F(-7, 2), F(12), F(-40), F(200), F(1, 10**9)):
        low, high = check_proof._exp(x, False), check_proof._exp(x, True)
        assert low <= high <= low * (1 + F(1, 10**22))
        with np.errstate(all="ignore"):
            assert float(low) == pytest.approx(np.exp(float(x)), rel=1e-14)
    # e to 40 digits
    e = F(27182818284590452353602874713526624977572, 10**40)
    assert check_proof._exp(F(1), False) < e < check_proof._exp(F(1), True)
    for x in (F(1), F(20), F(10) ** 12, F(4, 3)):
        bound = check_proof._log_above(x)
        assert check_proof._exp(bound, False) >= x
        assert float(bound) == pytest.approx(np.log(float(x)), rel=1e-12, abs=1e-15)


def sums_of(x: Any, u: Any, y: Any) -> Any:
    pairs = [[F(float(v)) for v in row] for row in np.hstack([x, u, y])]
    return check_proof._sums(pairs, x.shape[1] + u.shape[1], u.shape[1], x.shape[1])


def outside(rng: Any, noise: float | None, colour: float = 0.0, steps: int = 24) -> bool:
    """Whether the true system of a run under feedback is outside the checker's region at 20 %."""
    w, a, b = 0.0, rng.uniform(-0.4, 1.1), rng.uniform(0.2, 1.0)
    # 24 bits a number: sums of fractions are faster
    x = np.zeros((steps + 1, 1), dtype=np.float32)
    u = rng.standard_normal((steps, 1), dtype=np.float32)
    for t in range(steps):  # the input depends on all that was read
        u[t] = 0.7 * u[t] - 0.5 * x[t] - 0.3 * np.sign(x[: t + 1].sum())
        w = colour * w + 0.1 * rng.standard_normal()
        x[t + 1] = a * x[t] + b * u[t] + w
    known = [[F(noise) ** 2]] if noise else []
    C, V, fS = check_proof.region(sums_of(x[:-1], u, x[1:]), 2, F(1, 5), known)
    off = [[F(a) - C[0][0], F(b) - C[0][1]]]
    left = check_proof._product(check_proof._product(off, V), check_proof._turned(off))
    return left[0][0] > fS[0][0]


def test_the_region_holds_the_true_system(monkeypatch: Any) -> None:
    """At most 20 % may be missed; a false alarm has a probability below 1e-4."""
    monkeypatch.setattr(check_proof, "_log_above", cache(check_proof._log_above))  # of one level
    rng, count = np.random.default_rng(11), 100
    for noise in (None, 0.1):
        missed = sum(outside(rng, noise) for _ in range(count))
        assert missed <= most(count, 0.2), noise
        assert missed >= 1, noise  # a region that cannot miss proves nothing about this test
    wrong = sum(outside(rng, None, 0.95, 100) for _ in range(sets(20, 10)))
    assert wrong > 1  # noise that is not white


def test_a_loop_that_is_not_certified_has_no_proof(tmp_path: Path) -> None:
    x, u, w = np.random.default_rng(1).standard_normal((3, 40, 1))
    model = se.identify(se.Trajectories.from_pairs(x, u, 1.2 * x + u + 0.1 * w), noise=0.1)
    loop = se.gain(model, 1.0, 1.0)
    few = se.identify(
        se.Trajectories.from_pairs(x[:3], u[:3], 1.2 * x[:3] + u[:3] + w[:3]), noise=1.0
    )
    bad = se.gain(few, 1.0, 1.0).certificate(0.05)
    assert bad.status != "certified"
    with pytest.raises(se.StochensError, match="nothing is certified"):
        bad.save(tmp_path / "proof.json")
    proof = loop.certificate(0.05)
    assert proof.save(tmp_path / "proof.safetensors") == 1
    assert type(proof).load(tmp_path / "proof.safetensors") == proof
