"""Control of a linear system from random realizations of ``x0``, ``xf`` and ``A``.

The system is ``x(k+1) = A x(k) + B u(k)``. `sample` (or `Ensemble.from_samples`) makes an ensemble
of realizations, `fuse` an estimate from an ensemble, `control` a control from estimates; `steer`
does all three. `identify` makes a model and regions for it from measured runs, `Trajectories`, and
`ModelStream` while they are measured. `simulate` and `simulate_ensemble` apply a control.
`required_samples` says how many realizations a given error takes; `theory` has the error formulas,
`cases` example systems, `paper` the experiments and statements of the paper, `reference` the
algorithms in plain NumPy.
"""

import importlib
import logging
from typing import Any

from . import cases, exceptions, paper, plots, studies, theory
from ._base.threads import get_num_threads, set_num_threads
from ._core import version as _version
from .controls import (
    Plan,
    Regulator,
    control,
    control_fleet,
    predict,
    realization_controls,
    regulate,
    required_samples,
    steer,
)
from .ensembles import Counts, Ensemble, SystemEnsemble, sample, sample_counts
from .exceptions import StochensError
from .fusion import Fit, fuse, fuse_path
from .identification import Model, Trajectories, identify
from .rng import Key
from .simulation import (
    EnsembleTrajectory,
    Tracking,
    Trajectory,
    simulate,
    simulate_ensemble,
    track,
)
from .streams import DataStream, ModelStream, Stream
from .studies import Study
from .system import System

__version__ = _version()

__all__ = [
    "Counts",
    "DataStream",
    "Ensemble",
    "EnsembleTrajectory",
    "Fit",
    "Key",
    "Model",
    "ModelStream",
    "Plan",
    "Regulator",
    "StochensError",
    "Stream",
    "Study",
    "System",
    "SystemEnsemble",
    "Tracking",
    "Trajectories",
    "Trajectory",
    "__version__",
    "cases",
    "control",
    "control_fleet",
    "exceptions",
    "fuse",
    "fuse_path",
    "get_num_threads",
    "identify",
    "paper",
    "plots",
    "predict",
    "realization_controls",
    "reference",
    "regulate",
    "required_samples",
    "sample",
    "sample_counts",
    "set_num_threads",
    "simulate",
    "simulate_ensemble",
    "steer",
    "studies",
    "theory",
    "track",
]


def __getattr__(name: str) -> Any:
    if name == "reference":  # imported at its first use: the package does not need it
        return importlib.import_module(".reference", __name__)
    rooms = (k for k, v in globals().items() if k[0] != "_" and name in getattr(v, "__all__", ()))
    hint = next((f"; it is {__name__}.{room}.{name}" for room in rooms), "")
    raise AttributeError(f"{__name__} has no attribute {name!r}{hint}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__} - {"Any", "importlib", "logging"})


logging.getLogger("stochens").addHandler(logging.NullHandler())
