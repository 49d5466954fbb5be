"""Control of a linear system that is known only through random realizations.

From realizations of ``x0``, ``xf`` and ``A`` in ``x(k+1) = A x(k) + B u(k)`` to a control, and to
what is known about it: `sample` (or `Ensemble.from_samples`) makes an ensemble, `fuse` turns it
into an estimate, `control` into a control; `steer` does all three, `simulate` and
`simulate_ensemble` show what a control does. `theory` predicts how wrong the result is,
`required_samples` how many realizations it takes; `cases` brings systems to try, `experiments`
the two of the paper, and `claims` checks its statements one by one.
"""

import logging

from . import cases, exceptions, theory
from ._base.threads import get_num_threads, set_num_threads
from ._core import version as _version
from .controls.one_step import control, realization_controls
from .controls.plan import Plan
from .controls.plan_bound import PlanBound
from .controls.planning import SamplePlan, required_samples
from .controls.several_steps import control_steps
from .controls.steering import steer
from .controls.trajectory_plan import TrajectoryPlan
from .ensembles.counts import Counts
from .ensembles.ensemble import Ensemble
from .ensembles.sampling import sample, sample_counts
from .exceptions import (
    InputError,
    InputTypeError,
    InternalError,
    ResourceError,
    ShapeError,
    SolverError,
    StochensError,
)
from .fusion.fits import Fit, Path
from .fusion.fusing import fuse, fuse_path
from .paper import experiments
from .paper.verdicts.check import Claims, claims
from .rng import Key
from .simulation.closed_loop import Tracking, track
from .simulation.records import EnsembleTrajectory, Trajectory
from .simulation.simulating import simulate, simulate_ensemble
from .streams.data_stream import DataStream
from .streams.records import Confidence, StreamRun, Trace
from .streams.stream import Stream
from .system import System
from .theory.records import PlanError, Reachability

__version__ = _version()

__all__ = [
    "Claims",
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
    "TrajectoryPlan",
    "__version__",
    "cases",
    "claims",
    "control",
    "control_steps",
    "exceptions",
    "experiments",
    "fuse",
    "fuse_path",
    "get_num_threads",
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
