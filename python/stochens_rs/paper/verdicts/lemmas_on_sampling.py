"""Section 4 of the paper: the sampling scheme, Lemma 4.1, and what it says after it."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from math import exp

from . import rationals as exact
from .records import Claim, Evidence


def lemma_41() -> Claim:
    """The scheme is unbiased; the printed mean lacks a factor."""
    w = exact.vector(3, -1, 0, 2)
    N = 3
    total = average = exact.vector(0, 0, 0, 0)
    inside = True
    for p, samples in exact.sequences(w, N):
        mean = exact.mean(samples)
        total = exact.combine(exact.ONE, total, p * N, mean)
        average = exact.combine(exact.ONE, average, p, mean)
        inside &= all(x * y >= 0 and (y != 0 or x == 0) for x, y in zip(mean, w, strict=True))
    text = (
        f"w = (3, -1, 0, 2), all sequences of N = {N}: the mean of the sum is "
        f"({', '.join(map(str, total))}) = N w, that of the average w; no average has an entry of "
        "another sign, or one where w has none."
    )
    holds = average == w and total == tuple(N * x for x in w) and inside
    best = min(_second_moment(w, q) for q in _masses(len(w), 12) if _covers(q, w))
    g = sum((abs(x) for x in w), exact.ZERO)
    own = _second_moment(w, [abs(x) / g for x in w])
    optimal = (
        f"Among all masses q in twelfths, realizations w_i / q_i e_i have the least mean square "
        f"norm {best} at q = |w| / g, where it is g^2 = {g**2}."
    )
    return Claim(
        "Lemma 4.1",
        "The mean of the i-th component of the sum of N samples is w_i, and the average converges "
        "to w in probability.",
        "holds with a correction",
        "The mean of the sum is N w, that of the average w. Its covariance is (g diag|w| - w w^T) "
        "/ N. No unbiased realization with one entry has a smaller mean square norm than g^2.",
        (
            Evidence("enumeration", text, holds),
            Evidence("enumeration", optimal, best == own == g**2),
        ),
    )


def rows_or_columns() -> Claim:
    """Rows serve as well, with constants of their own."""
    A = (exact.vector(1, 1, 1), exact.vector(1, 0, 0), exact.vector(0, 1, 0))
    gamma = max(_one_norms(zip(*A, strict=True)))  # as printed: the largest column sum
    laws = {"columns": exact.matrix_atoms(A), "rows": exact.row_atoms(A)}
    means, squares, largest = {}, {}, {}
    for name, atoms in laws.items():
        means[name] = _mean([(p, _flat(one)) for p, one in atoms])
        squares[name] = sum(p * exact.distance(_flat(one), _flat(A)) for p, one in atoms)
        largest[name] = max(abs(x) for _, one in atoms for x in _flat(one))
    formulas = {  # sum of g_j^2 - ||a_j||^2 over the lines
        name: sum(g**2 - exact.dot(line, line) for g, line in zip(sums, lines, strict=True))
        for name, lines, sums in (
            ("columns", list(zip(*A, strict=True)), _one_norms(zip(*A, strict=True))),
            ("rows", A, _one_norms(A)),
        )
    }
    N, eps = 10, 2
    # a_11 is estimated by 3 in every realization, off by 2
    every = sum(p for p, one in laws["rows"] if one[0][0] - A[0][0] >= eps) ** N
    hoeffding = 2.0 * exp(-2.0 * N * eps**2 / float(gamma) ** 2)
    texts = (
        "A = [[1, 1, 1], [1, 0, 0], [0, 1, 0]], all realizations: drawn by columns and by rows, "
        f"the mean is A; the mean square errors are {squares['columns']} and {squares['rows']}, "
        "that is the sum of (sum of absolute values)^2 - (2-norm)^2 over the columns or rows.",
        f"The same A, g(A) = {gamma} as printed: by columns no entry exceeds it, by rows one is "
        f"{largest['rows']}. With N = {N} the mean of a_11 is off by {eps} with probability "
        f"{float(every):.1e} at least; Hoeffding's inequality with the range g(A) says "
        f"{hoeffding:.1e}.",
    )
    exact_laws = all(mean == _flat(A) for mean in means.values()) and squares == formulas
    return Claim(
        "Remark after Lemma 4.1, rows",
        '"for matrices, the same procedure can be performed via a similar transformation by '
        'considering each row (or column) separately as vectors".',
        "holds with a correction",
        "Both laws are without bias, but they are not the same law: the printed g(A), the largest "
        "column sum, and all that follows from it belong to columns. By rows the largest row sum "
        "takes its place, and the covariances are others.",
        (
            Evidence("enumeration", texts[0], exact_laws and squares["rows"] != squares["columns"]),
            Evidence(
                "exact",
                texts[1],
                largest["columns"] <= gamma < largest["rows"] and float(every) > hoeffding,
            ),
        ),
    )


def sparsity() -> Claim:
    """The pattern is kept from above only."""
    A = (exact.vector(1, 1, 0), exact.vector(1, 1, 1), exact.vector(0, 1, 1))
    whole = _pattern(A)
    atoms = exact.matrix_atoms(A)
    law: dict[frozenset[tuple[int, int]], Fraction] = {frozenset(): exact.ONE}
    complete = []
    for _ in range(4):  # pattern of the average of 1, 2, 3, 4 realizations
        longer: dict[frozenset[tuple[int, int]], Fraction] = {}
        for seen, p in law.items():
            for q, one in atoms:
                union = seen | _pattern(one)
                longer[union] = longer.get(union, exact.ZERO) + p * q
        law = longer
        complete.append(law.get(whole, exact.ZERO))
    inside = all(pattern <= whole for pattern in law)
    signs = all(x * y >= 0 for _, one in atoms for x, y in zip(_flat(one), _flat(A), strict=True))
    text = (
        f"A = [[1, 1, 0], [1, 1, 1], [0, 1, 1]], all {len(atoms)} realizations: none has an entry "
        "where A has none, or of another sign. Averages of 1, 2, 3, 4 of them have all the entries "
        f"of A with probability {', '.join(map(str, complete))}."
    )
    return Claim(
        "Remark after Lemma 4.1, sparsity",
        '"it retains the sparsity structure of the DLTI system".',
        "holds with a correction",
        "No entry is ever added and no sign changed, but entries are missing: a realization has "
        "one entry in every column, and an average has all the entries of A only when every one "
        "was hit.",
        (
            Evidence(
                "enumeration", text, inside and signs and complete[1] == 0 and 0 < complete[3] < 1
            ),
        ),
    )


def bernoulli() -> Claim:
    """A component has two values, and depends on the others."""
    w = exact.vector(3, -1, 0, 2)
    g = _one_norms([w])[0]
    atoms = exact.atoms(w)
    n = len(w)
    values = [sorted({atom[i] for _, atom in atoms}) for i in range(n)]
    two = all(values[i] == sorted({exact.ZERO, g * _sign(x)}) for i, x in enumerate(w))
    covariance = [
        [sum(p * (a[i] - w[i]) * (a[j] - w[j]) for p, a in atoms) for j in range(n)]
        for i in range(n)
    ]
    formula = [[(g * abs(w[i]) if i == j else 0) - w[i] * w[j] for j in range(n)] for i in range(n)]
    nearest = min(exact.distance(atom, w) for _, atom in atoms)
    text = (
        f"w = (3, -1, 0, 2), all realizations: the values of the components are "
        f"{', '.join('{' + ', '.join(map(str, v)) + '}' for v in values)}; the covariance of the "
        f"first and the last is {covariance[0][3]}. No realization is nearer to w than "
        f"||s - w||^2 = {nearest}."
    )
    return Claim(
        "Remark after Lemma 4.1, Bernoulli",
        '"since each component is a Bernoulli random variable, using known properties we can '
        'provide convergence rates for each realization".',
        "holds with a correction",
        "Component i is g sign(w_i) times a Bernoulli variable with mean |w_i| / g: its range is "
        "g, not 1, and the components are dependent, as exactly one is not 0. A realization does "
        "not converge; its averages do.",
        (
            Evidence(
                "enumeration",
                text,
                two and g != 1 and covariance == formula and covariance[0][3] < 0 < nearest,
            ),
        ),
    )


def _sign(x: Fraction) -> int:
    return (x > 0) - (x < 0)


def _one_norms(lines: Iterable[exact.Vector]) -> list[Fraction]:
    return [sum((abs(x) for x in line), exact.ZERO) for line in lines]


def _flat(A: exact.Matrix) -> exact.Vector:
    return tuple(x for row in A for x in row)


def _pattern(A: exact.Matrix) -> frozenset[tuple[int, int]]:
    return frozenset((i, j) for i, row in enumerate(A) for j, x in enumerate(row) if x != 0)


def _mean(law: list[tuple[Fraction, exact.Vector]]) -> exact.Vector:
    mean = (exact.ZERO,) * len(law[0][1])
    for p, one in law:
        mean = exact.combine(exact.ONE, mean, p, one)
    return mean


def _second_moment(w: exact.Vector, q: list[Fraction]) -> Fraction:
    """``sum_i w_i^2 / q_i``."""
    return sum((x * x / p for x, p in zip(w, q, strict=True) if x != 0), exact.ZERO)


def _covers(q: list[Fraction], w: exact.Vector) -> bool:
    return all(p > 0 or x == 0 for p, x in zip(q, w, strict=True))


def _masses(n: int, parts: int) -> list[list[Fraction]]:
    """All probability vectors with denominators `parts`."""
    if n == 1:
        return [[Fraction(parts, parts)]]
    found: list[list[Fraction]] = []

    def fill(done: list[int], left: int) -> None:
        if len(done) == n - 1:
            found.append([Fraction(k, parts) for k in (*done, left)])
            return
        for k in range(left + 1):
            fill([*done, k], left - k)

    fill([], parts)
    return found
