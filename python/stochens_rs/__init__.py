"""Control of a linear system that is known only through random realizations.

From realizations of ``x0``, ``xf`` and ``A`` in ``x(k+1) = A x(k) + B u(k)`` to a control, and to
what is known about it: `sample` (or `Ensemble.from_samples`) makes an ensemble, `fuse` turns it
into an estimate, `control` into a control; `steer` does all three. `theory.moments` predicts how
wrong the result is, `cases` brings systems to try, `experiments` the two of the paper.
"""

import logging

from . import cases, exceptions, experiments, theory
from ._core import version as _version
from ._threads import get_num_threads, set_num_threads
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
from .results import Fit, Path, Plan, PlanError, Reachability
from .rng import Key
from .sampling import sample, sample_counts
from .stream_records import Confidence, StreamRun, Trace
from .streaming import Stream
from .system import System

__version__ = _version()

__all__ = [
    "Confidence",
    "Counts",
    "DataStream",
    "Ensemble",
    "Fit",
    "InputError",
    "InputTypeError",
    "InternalError",
    "Key",
    "Path",
    "Plan",
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
    "__version__",
    "cases",
    "control",
    "exceptions",
    "experiments",
    "fuse",
    "fuse_path",
    "get_num_threads",
    "realization_controls",
    "sample",
    "sample_counts",
    "set_num_threads",
    "steer",
    "theory",
]

logging.getLogger("stochens").addHandler(logging.NullHandler())
