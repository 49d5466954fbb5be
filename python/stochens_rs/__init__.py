"""Control of a linear system that is known only through random realizations.

From realizations of ``x0``, ``xf`` and ``A`` in ``x(k+1) = A x(k) + B u(k)`` to a control, and to
what is known about it: `sample` (or `Ensemble.from_samples`) makes an ensemble, `fuse` turns it
into an estimate, `control` into a control; `steer` does all three, `simulate` and
`simulate_ensemble` show what a control does. `theory.moments` predicts how
wrong the result is, `cases` brings systems to try, `experiments` the two of the paper.
"""

import logging

from . import cases, exceptions, experiments, theory
from ._core import version as _version
from ._threads import get_num_threads, set_num_threads
from .closed_loop import Tracking, track
from .controls import control, realization_controls, steer
from .data_streaming import DataStream
from .ensembles import Counts, Ensemble
from .exceptions import (
    InputError,
    InputTypeError,
    InternalError,
    ResourceError,
    ShapeError,
    SolverError,
    StochensError,
)
from .fusing import fuse, fuse_path
from .multistep import control_steps
from .results import Fit, Path, Plan, PlanBound, PlanError, Reachability
from .rng import Key
from .sampling import sample, sample_counts
from .simulating import simulate, simulate_ensemble
from .stream_records import Confidence, StreamRun, Trace
from .streaming import Stream
from .system import System
from .trajectories import EnsembleTrajectory, Trajectory
from .trajectory_bounds import TrajectoryBound
from .trajectory_plans import TrajectoryPlan

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
    "ShapeError",
    "SolverError",
    "StochensError",
    "Stream",
    "StreamRun",
    "System",
    "Trace",
    "Tracking",
    "Trajectory",
    "TrajectoryBound",
    "TrajectoryPlan",
    "__version__",
    "cases",
    "control",
    "control_steps",
    "exceptions",
    "experiments",
    "fuse",
    "fuse_path",
    "get_num_threads",
    "realization_controls",
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
