"""Prove again that the gain in a C header stabilizes every linear system that measured data allow.

    python check_proof.py proof.json controller.h runs.csv --run run

Needs Python >= 3.10 alone, and knows nothing of what made the proof. All that decides is computed
in rational numbers, exp and log with bounds outward. Exit code 0: proved; 1: not proved.

The plant is ``y = Theta z + w``: z = (x, u) or (x, u, 1), y = x one step later, w Gaussian, white,
z chosen by anything that happened before. Of N pairs, N fixed beforehand, the first N // 2 give
Theta1 and, where no noise is declared, Sigma1. The likelihood of the other M pairs under these,
over the largest one with the true Theta, has a mean of at most 1, and is above 1 / delta with a
probability of at most delta (Wasserman, Ramdas and Balakrishnan 2020). So with C, V and R of the
least squares of these pairs, and R1 of their residuals under Theta1,

    (Theta - C) V (Theta - C)' <= f S        for the true Theta, with probability 1 - delta,
    declared S: f = 2 log(1 / delta) + tr S^-1 (R1 - R);    not declared: S = R,
    f = |Sigma1| / |R / M| exp(2 log(1 / delta) / M + tr(Sigma1^-1 R1) / M - n) - 1

With J = (I; K; 0), A0 = C J and Q of the proof, all ``A = Theta J`` of this set have A Q A' < Q, so
that they are stable, if ``[Q^-1 - J'V^-1 J / t, A0'; A0, Q - t f S] > 0`` for one t > 0 (S-lemma).
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import re
import struct
import sys
from fractions import Fraction as F
from pathlib import Path
from typing import Any

Matrix = list[list[F]]


def _need(condition: object, why: str) -> None:
    if not condition:
        raise ValueError(why)


def _product(a: Matrix, b: Matrix) -> Matrix:
    columns = list(zip(*b, strict=True))
    return [[sum((x * y for x, y in zip(r, c, strict=True)), F(0)) for c in columns] for r in a]


def _turned(a: Any) -> Matrix:
    return [list(row) for row in zip(*a, strict=True)]


def _plus(a: Matrix, b: Matrix, by: F | int = 1) -> Matrix:
    rows = zip(a, b, strict=True)
    return [[x + by * y for x, y in zip(r, s, strict=True)] for r, s in rows]


def _eye(n: int) -> Matrix:
    return [[F(int(i == j)) for j in range(n)] for i in range(n)]


def _solved(a: Matrix, b: Matrix) -> tuple[Matrix, F]:
    """``a^-1 b`` of a positive definite a, and ``|a|``; refuses another a."""
    n, size = len(a), F(1)
    rows = [list(r) + list(s) for r, s in zip(a, b, strict=True)]
    for i in range(n):
        _need(rows[i][i] > 0, "a matrix is not positive definite: too few data, or a wrong proof")
        size *= rows[i][i]
        for r in range(n):
            by = rows[r][i] / rows[i][i] if r != i else F(0)
            if by:
                rows[r] = [x - by * y for x, y in zip(rows[r], rows[i], strict=True)]
    return [[x / rows[i][i] for x in rows[i][n:]] for i in range(n)], size


def _positive(a: Any) -> bool:
    """Whether a symmetric matrix has pivots > 0: exact for rational numbers, a guess for floats."""
    a = [list(row) for row in a]
    for i in range(len(a)):
        if not a[i][i] > 0:
            return False
        for r in range(i + 1, len(a)):
            by = a[r][i] / a[i][i]
            a[r] = [x - by * y for x, y in zip(a[r], a[i], strict=True)]
    return True


def _rounded(x: F, up: bool) -> F:
    """A number of about 96 bits that is at least x, or at most."""
    scale = F(2) ** (96 - x.numerator.bit_length() + x.denominator.bit_length())
    whole = (x * scale).__floor__()
    return F(whole + (up and whole != x * scale)) / scale


def _exp(x: F, up: bool) -> F:
    """A bound of exp(x): the series at x / 2^k <= 1/8, with its rest, squared k times."""
    _need(abs(x) < 4000, "the data do not bound the systems: too few pairs")
    if x < 0:
        return 1 / _exp(-x, not up)
    halves = x.__floor__().bit_length() + 3
    x, total, term = _rounded(x / 2**halves, up), F(1), F(1)
    for k in range(1, 24):
        term = term * x / k
        total += term
    total += 2 * term * x if up else 0
    for _ in range(halves):
        total = _rounded(total * total, up)
    return total


def _log_above(x: F) -> F:
    """A number b with exp(b) >= x, for x >= 1."""
    low, high = F(0), F(x.__floor__().bit_length() + 1)
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if _exp(middle, False) >= x else (middle, high)
    return high


def _pairs(path: str, names: list[str], n: int, run: str | None) -> Matrix:
    """(x, u, x one step later) of rows that follow each other in a run: exact decimals."""
    pairs: Matrix = []
    before: Any = None
    names = [name.split(" [")[0].strip() for name in names]
    with open(path, newline="", encoding="utf-8-sig") as file:
        for cells in csv.DictReader(file):
            row = {str(k).split(" [")[0].strip(): str(v or "").strip() for k, v in cells.items()}
            missing = [name for name in (*names, *([run] if run else [])) if name not in row]
            _need(not missing, f"{path} has no column {missing[:1]}")
            now, mine = [row[name] for name in names], row[run] if run else None
            if before and before[1] == mine and all(before[0] + now[:n]):
                pairs.append([F(value) for value in before[0] + now[:n]])
            before = now, mine
    return pairs


def _sums(pairs: Matrix, d: int, m: int, n: int) -> dict[str, Any]:
    """Of both halves, the number of pairs and the sums of (z; y) (z; y)'; and the digest."""
    one = [F(1)] * (d - n - m)
    rows = [[*p[: n + m], *one, *p[n + m :]] for p in pairs]
    halves = [rows[: len(rows) // 2], rows[len(rows) // 2 :]]
    doubles = b"".join(struct.pack(f"<{len(p)}d", *map(float, p)) for p in pairs)
    totals = [_product(_turned(half), half) for half in halves if half]
    text = [[[str(v) for v in row] for row in total] for total in totals]
    sizes = [len(half) for half in halves]
    return {"counts": sizes, "totals": text, "sha256": hashlib.sha256(doubles).hexdigest()}


def _least_squares(total: Matrix, d: int) -> tuple[Matrix, Matrix, Matrix]:
    V, zy = [row[:d] for row in total[:d]], [row[d:] for row in total[:d]]
    C = _turned(_solved(V, zy)[0])
    return C, V, _plus([row[d:] for row in total[d:]], _product(C, zy), -1)


def region(sums: dict[str, Any], d: int, delta: F, noise: Matrix) -> tuple[Matrix, ...]:
    """C, V and f S of the systems that the data allow."""
    first, count = sums["counts"]
    one, other = ([[F(v) for v in row] for row in total] for total in sums["totals"])
    (C1, _, R1), (C, V, R) = _least_squares(one, d), _least_squares(other, d)
    n, level, off = len(C), _log_above(1 / delta), _plus(C1, C, -1)
    missed = _plus(R, _product(_product(off, V), _turned(off)))
    if noise:
        S, more = noise, _solved(noise, _plus(missed, R, -1))[0]
        f = 2 * level + sum(more[i][i] for i in range(n))
    else:
        _need(first > d + n and count > d + n, "too few pairs for a covariance: declare --noise")
        S, guess = R, [[v / (first - d) for v in row] for row in R1]
        trace, size = _solved(guess, missed)
        own = _solved([[v / count for v in row] for row in R], _eye(n))[1]
        power = 2 * level / count + sum(trace[i][i] for i in range(n)) / count - n
        f = size / own * _exp(power, True) - 1
    _need(f > 0, "the data contradict the noise that is assumed")
    return C, V, [[_rounded(f, True) * v for v in row] for row in S]


def stabilized(C: Matrix, V: Matrix, fS: Matrix, K: Matrix, Q: Matrix) -> F | None:
    """The t for which all systems of the region are proved to be stable; None without one."""
    n, d = len(C), len(V)
    J = [*_eye(n), *K, *([F(0)] * n for _ in range(d - n - len(K)))]
    A0, own, inverse = (
        _product(C, J),
        _product(_turned(J), _solved(V, J)[0]),
        _solved(Q, _eye(n))[0],
    )
    most = min(Q[i][i] / fS[i][i] for i in range(n))
    for k in range(1, 240):
        t = F(float(most) * 1.1**-k)
        top, low = _plus(inverse, own, -1 / t), _plus(Q, fS, -t)
        rows = [[*r, *s] for r, s in zip([*top, *A0], [*_turned(A0), *low], strict=True)]
        if _positive([[float(v) for v in row] for row in rows]) and _positive(rows):
            return t
    return None


def check(proof: Any, header: str, files: list[str], how: Any) -> str:
    """What is proved, in words; raises where nothing is."""
    seal = hashlib.sha256(json.dumps(proof["proof"], sort_keys=True).encode()).hexdigest()
    _need(proof["sha256"] == seal, "the proof was changed: its digest is another one")
    proof = proof["proof"]
    names, offset = [*proof["states"], *proof["inputs"]], proof["offset"]
    n, m, delta = len(proof["states"]), len(proof["inputs"]), F(proof["delta"])
    _need(0 < delta < 1 and offset in (0, 1) and n and m, "delta, offset or names are none")
    d, Q = n + m + offset, [[F(v) for v in row] for row in proof["Q"]]
    _need([len(row) for row in Q] == [n] * n and _turned(Q) == Q, "Q must be symmetric, (n, n)")
    table = re.findall(r"\b\w+_K\[(\d+)\] = \{([^}]*)\};", header)
    digest = re.findall(r"\bsha256 ([0-9a-f]{64})\b", header)
    _need(len(table) == 1 and len(digest) == 1, "the header must have a gain K, and a digest")
    found = [re.fullmatch(r"\w+_R\(([-+.\de]+)\)", one.strip()) for one in table[0][1].split(",")]
    gain = [F(float(one[1])) for one in found if one]  # as a compiler reads it
    _need(len(gain) == len(found) == n * m == int(table[0][0]), "the gain must have m n numbers")
    if files[0].endswith(".json"):
        sums = json.loads(Path(files[0]).read_text("utf-8"))
    else:
        pairs = [p for path in files for p in _pairs(path, names, n, how.run)]
        sums = _sums(pairs, d, m, n)
    _need(sums["sha256"] == digest[0], "the data are others than those of the header")
    if how.write_sums:
        Path(how.write_sums).write_text(json.dumps(sums), "utf-8")
    sizes = [F(v) ** 2 for v in (how.noise or "").split(",") if v]
    _need(len(sizes) in (0, n), "--noise must have a number for each state")
    noise = [[v * s for v in row] for row, s in zip(_eye(n), sizes, strict=False)]
    C, V, fS = region(sums, d, delta, noise)
    t = stabilized(C, V, fS, [gain[i * n : i * n + n] for i in range(m)], Q)
    _need(t is not None, "the proof does not hold for all systems that the data allow here")
    text = f"proved: u = K x stabilizes every system that {sum(sums['counts'])} pairs allow, with "
    text += f"probability {float(1 - delta):.6g}: Gaussian white noise of "
    return text + ("declared deviations" if noise else "one unknown covariance") + ", exact states"


def main() -> int:
    """Print the verdict."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("proof", help="proof.json")
    parser.add_argument("header", help="controller.h")
    parser.add_argument("data", nargs="+", help="CSV files in their order, or sums.json")
    parser.add_argument("--run", help="the column that says which run a row is of")
    parser.add_argument("--noise", help="declared standard deviations of the noise of each state")
    parser.add_argument("--write-sums", help="a file for the sums, which can replace the CSV")
    how = parser.parse_args()
    try:
        proof, header = (Path(one).read_text("utf-8") for one in (how.proof, how.header))
        print(check(json.loads(proof), header, how.data, how))
    except Exception as why:
        print(f"not proved: {why if type(why) is ValueError else repr(why)}")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
