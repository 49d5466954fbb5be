"""The same computations in plain NumPy, written to be read beside the equations.

Nothing here is used by the rest of the package, and nothing of the package is used here: the two
share the mathematics and the definition of the random streams, not a line of code. Tests compare
them bit for bit where that is promised (random draws) and to rounding elsewhere.

* `streams`  - random words: ChaCha8, xoshiro256++, the alias table, the shuffle;
* `sampling` - realizations as indices, and what is built from indices;
* `fusing`   - weights: uniform, ALSE, SLSE;
* `controls` - pseudoinverse, controls, and how wrong they are;
* `simulation` - trajectories: exact, random runs, mean fields, along a reference.
* `streaming` - the sequential algorithm, and what data say about their mean.

Arrays go in and come out plain: `indices` is (N, lines), `samples` is (N, n) or (N, n, m), `key`
is 32 bytes. Input is taken as finite and well shaped; nothing is checked.
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
from .streaming import Streamed, mean_radius, stream
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

__all__ = [
    "AliasTable",
    "Fused",
    "Greedy",
    "PlanError",
    "Reachability",
    "Streamed",
    "alias_table",
    "alse_dense",
    "alse_singleton",
    "atoms",
    "average",
    "chacha8_words",
    "chacha_blocks",
    "child",
    "combine",
    "control",
    "counts",
    "dense",
    "draw",
    "frank_wolfe_gap",
    "from_lines",
    "fuse_path",
    "iid_words",
    "masses",
    "mean_radius",
    "pinv",
    "plan_error",
    "project_simplex",
    "project_subsimplex",
    "reachability",
    "realization_controls",
    "sample_indices",
    "shuffle",
    "simulate",
    "simulate_mean_field",
    "simulate_runs",
    "slse",
    "slse_safeguarded",
    "stream",
    "systematic_counts",
    "to_lines",
    "track",
    "uniform",
    "xoshiro256pp",
]
