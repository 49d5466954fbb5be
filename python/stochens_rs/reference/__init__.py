"""The same computations in plain NumPy, close to the equations.

This package and the rest of `stochens_rs` do not import each other: they share the mathematics and
the definition of the random streams, but no code. `validate` compares them on this machine: the
random draws bit for bit and all other results to rounding.

* `streams`  - random words: ChaCha8, xoshiro256++, the alias table, the shuffle;
* `sampling` - realizations as indices, and what is built from indices;
* `fusing`   - weights: uniform, ALSE, SLSE;
* `controls` - pseudoinverse, controls and their errors;
* `simulation` - trajectories: exact, random runs, mean fields, along a reference.

Arguments and results are arrays: `indices` is (N, lines), `samples` is (N, n) or (N, n, m), `key`
is 32 bytes. Input must be finite and of the right shape; it is not checked.
"""

from __future__ import annotations

from .controls import (
    PlanError,
    Reachability,
    control,
    pinv,
    plan_error,
    reachability,
    realization_controls,
)
from .fusing import (
    Fused,
    Greedy,
    alse_dense,
    alse_singleton,
    frank_wolfe_gap,
    fuse_path,
    project_simplex,
    project_subsimplex,
    slse,
    slse_safeguarded,
    uniform,
)
from .sampling import (
    atoms,
    combine,
    counts,
    dense,
    from_lines,
    sample_indices,
    systematic_counts,
    to_lines,
)
from .simulation import average, simulate, simulate_mean_field, simulate_runs, track
from .streams import (
    AliasTable,
    alias_table,
    chacha8_words,
    chacha_blocks,
    child,
    draw,
    iid_words,
    masses,
    shuffle,
    xoshiro256pp,
)
from .validation import Comparison, validate

__all__ = [
    "AliasTable", "Comparison", "Fused", "Greedy", "PlanError", "Reachability", "alias_table",
    "alse_dense", "alse_singleton", "atoms", "average", "chacha8_words", "chacha_blocks",
    "child", "combine", "control", "counts", "dense", "draw", "frank_wolfe_gap", "from_lines",
    "fuse_path", "iid_words", "masses", "pinv", "plan_error", "project_simplex",
    "project_subsimplex", "reachability", "realization_controls", "sample_indices", "shuffle",
    "simulate", "simulate_mean_field", "simulate_runs", "slse", "slse_safeguarded",
    "systematic_counts", "to_lines", "track", "uniform", "validate", "xoshiro256pp",
]  # fmt: skip
