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

from . import controls, fusing, sampling, simulation, streams
from .validation import Comparison, validate

__all__ = ["Comparison", "controls", "fusing", "sampling", "simulation", "streams", "validate"]
