"""Control of a linear system that is known only through random realizations.

From realizations of ``x0``, ``xf`` and ``A`` in ``x(k+1) = A x(k) + B u(k)`` to a control, and to
what is known about it: `sample` (or `Ensemble.from_samples`) makes an ensemble, `fuse` turns it
into an estimate, `control` into a control; `steer` does all three, `simulate` and
`simulate_ensemble` show what a control does. `theory` predicts how wrong the result is,
`required_samples` how many realizations it takes; `cases` brings systems to try, and `paper` has
the experiments of the paper and checks its statements one by one.
"""

import logging

from . import cases, exceptions, paper, theory
from ._base.threads import get_num_threads, set_num_threads
from ._core import version as _version
from .controls import (
    Plan,
    PlanBound,
    SamplePlan,
    control,
    realization_controls,
    required_samples,
    steer,
)
from .ensembles import Counts, Ensemble, sample, sample_counts
from .exceptions import (
    InputError,
    InputTypeError,
    InternalError,
    ResourceError,
    ShapeError,
    SolverError,
    StochensError,
)
from .fusion import Fit, Path, fuse, fuse_path
from .rng import Key
from .simulation import (
    EnsembleTrajectory,
    Tracking,
    Trajectory,
    simulate,
    simulate_ensemble,
    track,
)
from .streams import Confidence, DataStream, Stream, StreamRun, Trace
from .system import System
from .theory.records import PlanError, Reachability

__version__ = _version()

__all__ = [
    "Confidence",
    "Counts",
    "DataStream",
    "Ensemble",
    "EnsembleTrajectory",
    "Fit",
    "InputError",
    "InputTypeError",
    "InternalError",
    "Key",
    "Path",
    "Plan",
    "PlanBound",
    "PlanError",
    "Reachability",
    "ResourceError",
    "SamplePlan",
    "ShapeError",
    "SolverError",
    "StochensError",
    "Stream",
    "StreamRun",
    "System",
    "Trace",
    "Tracking",
    "Trajectory",
    "__version__",
    "cases",
    "control",
    "exceptions",
    "fuse",
    "fuse_path",
    "get_num_threads",
    "paper",
    "realization_controls",
    "required_samples",
    "sample",
    "sample_counts",
    "set_num_threads",
    "simulate",
    "simulate_ensemble",
    "steer",
    "theory",
    "track",
]

logging.getLogger("stochens").addHandler(logging.NullHandler())
