"""Mutants of the functions behind `claims`, for every evidence of every row.

A mutant replaces an estimator, a formula, the realizations or a counterexample. With it the row is
computed again, and that evidence has to be contrary.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, TypeAlias

import numpy as np
import pytest

import paper
import stochens_rs as se
from paper import bounds as printed_bounds
from paper import power, rationals, reachability, tracking
from paper.experiments import replicate
from paper.verdicts import (
    algorithm_1,
    comparison,
    definitions,
    lemmas_on_reachability,
    lemmas_on_sampling,
    lemmas_on_tails,
    lemmas_on_weights,
    printed_figures,
    section_5_2,
    tails,
)
from stochens_rs import System
from stochens_rs.fusion import Alse
from stochens_rs.rng import as_key

KEY = as_key(1)
W = np.array([2.0, 1.0, 1.0])

Patch: TypeAlias = "Callable[[pytest.MonkeyPatch], None]"

# each row on its own, as small as its evidence allows
ROWS: dict[str, Callable[[], paper.Claim]] = {
    "Contribution vi": lambda: algorithm_1.variance(algorithm_1.measure(KEY, runs=3)),
    "Definition 2.1, eq. (3)": definitions.solution_formula,
    "Definition 2.2": definitions.index_maps,
    "Definition 2.3": lambda: definitions.approximate_reachability(KEY),
    "Definition 2.4": lambda: definitions.sample_reachability(KEY),
    "Lemma 3.1": lemmas_on_reachability.lemma_31,
    "Remark after Lemma 3.1": lemmas_on_reachability.remark_31,
    "Lemma 3.2": lemmas_on_reachability.lemma_32,
    "Remark after Lemma 3.2, reachable": lemmas_on_reachability.remark_32_reachable,
    "Remark after Lemma 3.2, any sequence": lemmas_on_reachability.remark_32_any,
    "Lemma 4.1": lemmas_on_sampling.lemma_41,
    "Remark after Lemma 4.1, rows": lemmas_on_sampling.rows_or_columns,
    "Remark after Lemma 4.1, sparsity": lemmas_on_sampling.sparsity,
    "Remark after Lemma 4.1, Bernoulli": lemmas_on_sampling.bernoulli,
    "Lemma 4.2": lambda: lemmas_on_tails.lemma_42(tails.measure(KEY, runs=150)),
    "Proof of Lemma 4.2, norm": lemmas_on_tails.proof_of_lemma_42,
    "Lemma 4.3": lambda: lemmas_on_tails.lemma_43(KEY),
    "Lemma 4.4": lemmas_on_weights.lemma_44,
    "Remark after Lemma 4.4": lambda: lemmas_on_weights.exact_recovery(KEY),
    "Algorithm 1, lines 3 and 16": algorithm_1.lines_3_and_16,
    "Algorithm 1": lambda: algorithm_1.algorithm_1(algorithm_1.measure(KEY, runs=3)),
    "Lemma 4.5, recursion": lemmas_on_weights.recursion,
    "Lemma 4.5, first inequality": lambda: lemmas_on_weights.first_inequality(KEY),
    "Lemma 4.5, second inequality": lambda: lemmas_on_weights.second_inequality(
        comparison.compare(W, KEY, 200, 50)
    ),
    "Lemma 4.5, norm": lemmas_on_weights.norms,
    "Figure 1": lambda: printed_figures._estimates(power(rng=1, replicates=4, samples=300)),
    "Figure 2": lambda: printed_figures._controls(power(rng=1, replicates=4, samples=300)),
    "Section 5.2, one step": lambda: section_5_2.one_step_only(KEY),
    "Figure 3": lambda: printed_figures._states(KEY, _large()),
    "Figure 3, order": lambda: section_5_2.ordering(_large()),
    "Section 5.2, computed states": section_5_2.computed_states,
}


def _large() -> Any:
    return tracking(rng=1, replicates=2, samples=300, n=20, m=16)


# -- mutants ---------------------------------------------------------------------------------------


def put(owner: Any, name: str, value: Any) -> Patch:
    """Replace a name by a value."""
    return lambda patch: patch.setattr(owner, name, value)


def change(owner: Any, name: str, changed: Callable[..., Any]) -> Patch:
    """Replace a function by one that gets the original as its first argument."""
    honest = getattr(owner, name)
    return put(owner, name, lambda *args, **kwargs: changed(honest, *args, **kwargs))


def both(*patches: Patch) -> Patch:
    def apply(patch: pytest.MonkeyPatch) -> None:
        for one in patches:
            one(patch)

    return apply


def scaled_atoms(factor: Callable[[Any], Any]) -> Patch:
    """Realizations with atoms multiplied by a factor."""
    return change(
        rationals, "atoms", lambda honest, w: [(p, factor(w) * atom) for p, atom in honest(w)]
    )


def as_method(owner: Any, name: str, given: str, taken: str) -> Patch:
    """Fuse by another method than the one given."""

    def asked(x: Any) -> bool:
        return (isinstance(x, str) and x == given) or (isinstance(x, Alse) and given == "alse")

    def other(honest: Any, *args: Any, **kwargs: Any) -> Any:
        swapped = [taken if asked(x) else x for x in args]
        fit = honest(*swapped, **kwargs)
        # what the method asked for would say of itself, so that nothing but the weights differs
        return replace(fit, gap=0.0) if isinstance(fit, se.Fit) else fit

    return change(owner, name, other)


def certain(w: Any) -> Any:
    """No randomness: the only realization is the vector or matrix itself."""
    return [(rationals.ONE, w)]


def exact_path(*methods: str) -> Patch:
    """Methods that return the target."""

    def exact(honest: Any, ensemble: Any, sizes: Any, method: Any, **kwargs: Any) -> Any:
        path = honest(ensemble, sizes, method, **kwargs)
        if ("alse" if isinstance(method, Alse) else method) not in methods:
            return path
        right = np.broadcast_to(kwargs["target"], path.estimates.shape)
        return replace(path, estimates=right, errors=0.0 * path.errors)

    return change(replicate, "fuse_path", exact)


fused_loop = put(algorithm_1, "PrintedLoop", se.Stream)
printed_loop = put(algorithm_1, "Stream", algorithm_1.PrintedLoop)
aligned = put(reachability, "_GOOD", {"x0": 0, "A": 0, "B": 0, "xf": 0})
deterministic = both(put(rationals, "atoms", certain), put(rationals, "matrix_atoms", certain))
unsigned = change(rationals, "atoms", lambda honest, w: [(p, abs(atom)) for p, atom in honest(w)])
double = scaled_atoms(lambda w: 2)
unit = scaled_atoms(lambda w: 1 / (abs(w).sum() or rationals.ONE))
rows_like_columns = put(rationals, "row_atoms", rationals.matrix_atoms)
alse_is_the_mean = put(rationals, "alse", lambda samples, w: rationals.mean(samples))
slse_no_worse_than_the_mean = change(
    rationals,
    "slse",
    lambda honest, samples, w: [
        min(error, rationals.square(rationals.mean(samples[: k + 1]) - w))
        for k, error in enumerate(honest(samples, w))
    ],
)
printed_recursion = put(
    rationals,
    "slse",
    lambda samples, w: [rationals.square(rationals.towards(samples[1], samples[0], w) - w)],
)


def _scaled_bound(honest: Any, *args: Any, **kwargs: Any) -> Any:
    radius, name = honest(*args, **kwargs)
    return 0.2 * radius, name


loop_of_fused = put(algorithm_1, "_printed", lambda s, w: rationals.slse_path(s, w)[-1])
mean_for_alse = as_method(lemmas_on_weights, "fuse", "alse", "uniform")
# sqrt is in the radius only; the probability of an error is left as it is
half_of_mcdiarmid = change(
    printed_bounds, "Corrected", lambda honest, V, W: honest(V / 4.0, W / 4.0)
)


class WrongStream(se.Stream):
    """A stream whose control is wrong by 3 %."""

    @property
    def u(self) -> Any:
        return 1.03 * super().u


MUTANTS: dict[tuple[str, int], dict[str, Patch]] = {
    ("Contribution vi", 0): {
        "the printed loop has fused estimates": loop_of_fused,
        "SLSE is the printed loop": put(
            rationals, "slse", lambda s, w: [rationals.square(algorithm_1._printed(s, w) - w)]
        ),
    },
    ("Contribution vi", 1): {
        "both with fused estimates": fused_loop,
        "both as printed": printed_loop,
        "a bound that is too small": change(
            algorithm_1, "mean_square_bound", lambda honest, *args: 1e-4 * honest(*args)
        ),
    },
    ("Contribution vi", 2): {
        "the printed loop has fused estimates": loop_of_fused,
        "a bound that says nothing": change(
            algorithm_1,
            "Lemma42",
            lambda honest, system, x0, xf, C: honest(system, 100.0 * x0, xf, C=C),
        ),
    },
    ("Definition 2.1, eq. (3)", 0): {
        "products from left to right": change(
            definitions, "_product", lambda honest, factors: honest(factors[::-1])
        )
    },
    ("Definition 2.2", 0): {"no randomness": put(rationals, "matrix_atoms", certain)},
    ("Definition 2.3", 0): {
        "another length": double,
        "every control is the chosen one": put(rationals, "square", lambda x: rationals.ZERO),
    },
    ("Definition 2.3", 1): {
        "biased realizations": change(
            definitions,
            "simulate_ensemble",
            lambda honest, system, *args, **kwargs: honest(
                System(1.5 * system.A, system.B), *args, **kwargs
            ),
        )
    },
    ("Definition 2.4", 0): {
        "no randomness": both(
            put(definitions, "_atoms_of_vector", lambda x: (x[None], np.ones(1))),
            put(definitions, "_atoms_of_product", lambda A, x0: ((A @ x0)[None], np.ones(1))),
        )
    },
    ("Lemma 3.1", 0): {"good realizations in one run": aligned},
    ("Remark after Lemma 3.1", 0): {"good realizations in one run": aligned},
    ("Lemma 3.2", 0): {"good realizations at one index": aligned},
    ("Lemma 3.2", 1): {
        "every control 3 % too large": change(
            lemmas_on_reachability,
            "control",
            lambda honest, *args, **more: SimpleNamespace(u=1.03 * honest(*args, **more).u),
        ),
        "realization controls 3 % too large": change(
            lemmas_on_reachability,
            "realization_controls",
            lambda honest, *args: 1.03 * honest(*args),
        ),
        "another length": double,
    },
    ("Remark after Lemma 3.2, reachable", 0): {"good realizations at one index": aligned},
    ("Remark after Lemma 3.2, reachable", 1): {"biased realizations": double},
    ("Remark after Lemma 3.2, any sequence", 0): {
        "realizations in phase": change(
            lemmas_on_reachability, "_alternating", lambda honest, N: (honest(N)[0],) * 2
        ),
        "realizations with another average": change(
            lemmas_on_reachability,
            "_alternating",
            lambda honest, N: (honest(N)[0], 0 * honest(N)[0]),
        ),
    },
    ("Lemma 4.1", 0): {"no signs": unsigned, "another length": double},
    ("Lemma 4.1", 1): {
        "another mean square": put(
            lemmas_on_sampling,
            "_second_moment",
            lambda w, q: sum(abs(x) / p for x, p in zip(w, q, strict=True) if x),
        )
    },
    ("Remark after Lemma 4.1, rows", 0): {
        "rows drawn by columns": rows_like_columns,
        "another length": double,
    },
    ("Remark after Lemma 4.1, rows", 1): {"rows drawn by columns": rows_like_columns},
    ("Remark after Lemma 4.1, sparsity", 0): {
        "entries where A has none": put(
            rationals,
            "matrix_atoms",
            lambda A: [(rationals.ONE, rationals.array(np.ones((3, 3), dtype=int)))],
        ),
        "no randomness": put(rationals, "matrix_atoms", certain),
        "other signs": scaled_atoms(lambda w: -1),
    },
    ("Remark after Lemma 4.1, Bernoulli", 0): {
        "values 0 and 1": unit,
        "no randomness": put(rationals, "atoms", certain),
    },
    ("Lemma 4.2", 0): {
        "a printed bound that holds": put(
            printed_bounds, "OneVector", lambda w, C: printed_bounds.Corrected(0.5, 1.0)
        ),
        "a bound of ours that does not": put(
            printed_bounds, "Corrected", lambda *_: printed_bounds.OneVector([0.5, 0.5], C=4.0)
        ),
    },
    ("Lemma 4.2", 1): {
        "a printed bound that holds": change(
            printed_bounds,
            "Lemma42",
            lambda honest, *args, **kwargs: honest(*args, **(kwargs | {"reading": "realizations"})),
        ),
        "a bound of ours that does not": change(tails, "drawn_bound", _scaled_bound),
    },
    ("Lemma 4.2", 2): {
        "||A|| for the largest realization": put(
            printed_bounds, "largest_realization", lambda A: float(np.linalg.norm(A, 2))
        )
    },
    ("Lemma 4.2", 3): {"McDiarmid's radius halved": half_of_mcdiarmid},
    ("Proof of Lemma 4.2, norm", 0): {
        "the largest entry for a sum": put(
            lemmas_on_tails, "_row_sums", lambda M: max(abs(x) for row in M for x in row)
        ),
        "a smaller constant": change(
            rationals, "spectral_at_most", lambda honest, M, bound: honest(M, bound * 3 / 4)
        ),
    },
    ("Lemma 4.3", 0): {
        "a bound that holds": put(
            printed_bounds,
            "Lemma43",
            lambda system, x0, u, C: printed_bounds.Corrected(255.0, 512.0),  # n = 16
        )
    },
    ("Lemma 4.3", 1): {
        "a system without randomness": change(
            lemmas_on_tails,
            "simulate_ensemble",
            lambda honest, system, *args, **kwargs: honest(
                System(np.eye(2), system.B), *args, **kwargs
            ),
        )
    },
    ("Lemma 4.3", 2): {"McDiarmid's radius halved": half_of_mcdiarmid},
    ("Lemma 4.4", 0): {"realizations of length 1": unit},
    ("Lemma 4.4", 1): {"realizations of length 1": unit},
    ("Remark after Lemma 4.4", 0): {
        "weights for every column": put(rationals, "slse", lambda samples, w: [rationals.ZERO])
    },
    ("Remark after Lemma 4.4", 1): {"ALSE is the mean": mean_for_alse},
    ("Algorithm 1, lines 3 and 16", 0): {"no randomness": deterministic, "another length": double},
    ("Algorithm 1", 0): {"both with fused estimates": fused_loop, "both as printed": printed_loop},
    ("Algorithm 1", 1): {
        "every control 3 % too large": put(algorithm_1, "Stream", WrongStream),
        "both as printed": printed_loop,
    },
    ("Algorithm 1", 2): {"the certificate as rule": fused_loop},
    ("Lemma 4.5, recursion", 0): {"the corrected recursion is the printed one": printed_recursion},
    ("Lemma 4.5, recursion", 1): {
        "the corrected recursion is the printed one": printed_recursion,
        "the segment contains the target": put(rationals, "towards", lambda F, E, target: target),
    },
    ("Lemma 4.5, first inequality", 0): {
        "ALSE is the mean": mean_for_alse,
        "ALSE is SLSE": as_method(lemmas_on_weights, "fuse", "alse", "slse"),
        "the closed form is the mean": alse_is_the_mean,
        "the closed form is off the simplex": put(rationals, "alse", lambda samples, w: w),
    },
    ("Lemma 4.5, first inequality", 1): {
        "ALSE is the mean": mean_for_alse,
        "ALSE is SLSE": as_method(lemmas_on_weights, "fuse", "alse", "slse"),
        "SLSE is ALSE": as_method(lemmas_on_weights, "fuse", "slse", "alse"),
    },
    ("Lemma 4.5, second inequality", 0): {
        "SLSE is no worse than the mean": slse_no_worse_than_the_mean
    },
    ("Lemma 4.5, second inequality", 1): {
        "SLSE is no worse than the mean": slse_no_worse_than_the_mean
    },
    ("Lemma 4.5, second inequality", 2): {
        "V / n is too small": change(comparison, "mse", lambda honest, w, N: 0.3 * honest(w, N))
    },
    ("Lemma 4.5, norm", 0): {
        "Frobenius norms": put(
            rationals, "spectral_at_most", lambda M, bound: rationals.square(M) <= bound
        ),
        "ALSE is not the optimum": put(rationals, "towards", lambda F, E, target: F),
    },
    ("Lemma 4.5, norm", 1): {"ALSE is the mean": alse_is_the_mean},
    ("Figure 1", 0): {
        "ALSE is the mean": as_method(replicate, "fuse_path", "alse", "uniform"),
        "SLSE is ALSE": as_method(replicate, "fuse_path", "slse", "alse"),
    },
    ("Figure 2", 0): {"ALSE is exact from the first realization on": exact_path("alse")},
    ("Section 5.2, one step", 0): {
        "no randomness": put(rationals, "matrix_atoms", certain),
        "every control 3 % too large": change(
            section_5_2,
            "control",
            lambda honest, *args, **kwargs: SimpleNamespace(u=1.03 * honest(*args, **kwargs).u),
        ),
    },
    ("Section 5.2, one step", 1): {
        "no more realizations": change(
            section_5_2, "sample_counts", lambda honest, A, N, **kwargs: honest(A, 100, **kwargs)
        )
    },
    ("Figure 3", 0): {
        "the same error in all dimensions": put(
            printed_figures,
            "state_rms",
            lambda system, x0, xf, N, **_: 0.2 * float(np.linalg.norm(system.A @ x0)),
        )
    },
    ("Figure 3", 1): {
        "longer realizations": change(
            replicate, "sample", lambda honest, M, *args, **kwargs: honest(2.0 * M, *args, **kwargs)
        )
    },
    ("Figure 3, order", 0): {"A = I": put(section_5_2, "_GAINS", (1, 1, 1))},
    ("Figure 3, order", 1): {"ALSE and SLSE are exact": exact_path("alse", "slse")},
    ("Section 5.2, computed states", 0): {"good realizations at one index": aligned},
    ("Section 5.2, computed states", 1): {
        "the same realization twice": put(section_5_2, "_average_of_two", lambda law: law),
        "another length": double,
    },
}
