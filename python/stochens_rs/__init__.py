"""Control of a linear system from random realizations of ``x0``, ``xf`` and ``A``.

The system is ``x(k+1) = A x(k) + B u(k)``. `sample` (or `Ensemble.from_samples`) makes an ensemble
of realizations, `fuse` an estimate from an ensemble, `control` a control from estimates; `steer`
does all three. `identify` makes a model and regions for it from measured runs, `Trajectories`, and
`ModelStream` while they are measured. `simulate` and `simulate_ensemble` apply a control.
`required_samples` says how many realizations a given error takes; `theory` has the error formulas,
`cases` example systems, `reference` the algorithms in plain NumPy.
"""

import importlib
import logging
import os
from typing import TYPE_CHECKING, Any

try:
    from ._core import version as _version
except ImportError:
    if not os.path.isfile(__file__):  # without this it is said to be a circular import
        raise ImportError(
            "stochens_rs has compiled code, which Python does not load from a zip file: install it"
        ) from None
    raise

if TYPE_CHECKING:
    from . import cases, exceptions, plots, studies, theory
    from ._base.running import get_num_threads, set_num_threads
    from .certificates import Certificate
    from .controls import Plan, design, predict, realization_controls, required_samples, steer
    from .controls.control import control
    from .ensembles import Counts, Ensemble, SystemEnsemble, sample, sample_counts
    from .exceptions import StochensError
    from .feedback import gain
    from .fleet import control_fleet
    from .fusion import Fit, fuse, fuse_path
    from .identification import Misfit, Model, Noise, Pilot, Trajectories, Window, identify
    from .limits import Cost, Forecast, Limits, Uncertain
    from .loops import Keep, Regulator, regulate
    from .rng import Key
    from .simulation import (
        EnsembleTrajectory,
        StepEstimate,
        Tracking,
        Trajectory,
        simulate,
        simulate_ensemble,
        track,
    )
    from .streams import DataStream, ModelStream, Stream
    from .studies import Study
    from .system.system import System

__version__ = _version()

__all__ = [
    "Certificate",
    "Cost",
    "Counts",
    "DataStream",
    "Ensemble",
    "EnsembleTrajectory",
    "Fit",
    "Forecast",
    "Keep",
    "Key",
    "Limits",
    "Misfit",
    "Model",
    "ModelStream",
    "Noise",
    "Pilot",
    "Plan",
    "Regulator",
    "StepEstimate",
    "StochensError",
    "Stream",
    "Study",
    "System",
    "SystemEnsemble",
    "Tracking",
    "Trajectories",
    "Trajectory",
    "Uncertain",
    "Window",
    "__version__",
    "cases",
    "control",
    "control_fleet",
    "design",
    "exceptions",
    "fuse",
    "fuse_path",
    "gain",
    "get_num_threads",
    "identify",
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

# Where each name comes from. Nothing is imported before its first use: `import stochens_rs` then
# adds a few milliseconds to that of NumPy.
_ROOMS = {
    "_base.running": "get_num_threads set_num_threads",
    "certificates": "Certificate",
    "controls": "Plan control design predict realization_controls required_samples steer",
    "ensembles": "Counts Ensemble SystemEnsemble sample sample_counts",
    "exceptions": "StochensError",
    "feedback": "gain",
    "fleet": "control_fleet",
    "fusion": "Fit fuse fuse_path",
    "identification": "Misfit Model Noise Pilot Trajectories Window identify",
    "limits": "Cost Forecast Limits Uncertain",
    "loops": "Keep Regulator regulate",
    "rng": "Key",
    "simulation": "EnsembleTrajectory StepEstimate Tracking Trajectory simulate "
    "simulate_ensemble track",
    "streams": "DataStream ModelStream Stream",
    "studies": "Study",
    "system": "System",
    "validation": "",
}
_HOME = {name: room for room, names in _ROOMS.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    if name not in _HOME and name not in __all__ and name not in _ROOMS:
        raise AttributeError(f"{__name__} has no attribute {name!r}{_hint(name)}")
    room = importlib.import_module(f".{_HOME.get(name, name)}", __name__)
    importlib.import_module("._base.running", __name__).own_errors(__name__)
    value = globals()[name] = getattr(room, name) if name in _HOME else room
    return value


def _hint(name: str) -> str:
    """Say where a name that is not at the top can be found."""
    if not name.startswith("_"):
        for room in sorted({*_ROOMS, *__all__} - {*_HOME, "_base.running", "__version__"}):
            found = importlib.import_module(f".{room}", __name__)
            if name in getattr(found, "__all__", ()):
                return f"; it is {__name__}.{room}.{name}"
    return ""


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__} - {"Any", "TYPE_CHECKING", "importlib", "logging", "os"})


logging.getLogger("stochens").addHandler(logging.NullHandler())
