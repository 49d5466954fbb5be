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
    from . import cases as cases
    from . import exceptions as exceptions
    from . import plots as plots
    from . import studies as studies
    from . import theory as theory
    from ._base.running import get_num_threads as get_num_threads
    from ._base.running import set_num_threads as set_num_threads
    from .certificates import Certificate as Certificate
    from .controls import Plan as Plan
    from .controls import design as design
    from .controls import predict as predict
    from .controls import realization_controls as realization_controls
    from .controls import required_samples as required_samples
    from .controls import steer as steer
    from .controls.control import control as control
    from .ensembles import Counts as Counts
    from .ensembles import Ensemble as Ensemble
    from .ensembles import SystemEnsemble as SystemEnsemble
    from .ensembles import sample as sample
    from .ensembles import sample_counts as sample_counts
    from .exceptions import StochensError as StochensError
    from .feedback import gain as gain
    from .fleet import control_fleet as control_fleet
    from .fusion import Fit as Fit
    from .fusion import fuse as fuse
    from .fusion import fuse_path as fuse_path
    from .identification import Misfit as Misfit
    from .identification import Model as Model
    from .identification import Noise as Noise
    from .identification import Pilot as Pilot
    from .identification import Trajectories as Trajectories
    from .identification import Window as Window
    from .identification import identify as identify
    from .limits import Cost as Cost
    from .limits import Forecast as Forecast
    from .limits import Limits as Limits
    from .limits import Uncertain as Uncertain
    from .loops import Keep as Keep
    from .loops import Regulator as Regulator
    from .loops import regulate as regulate
    from .rng import Key as Key
    from .simulation import EnsembleTrajectory as EnsembleTrajectory
    from .simulation import StepEstimate as StepEstimate
    from .simulation import Tracking as Tracking
    from .simulation import Trajectory as Trajectory
    from .simulation import simulate as simulate
    from .simulation import simulate_ensemble as simulate_ensemble
    from .simulation import track as track
    from .streams import DataStream as DataStream
    from .streams import ModelStream as ModelStream
    from .streams import Stream as Stream
    from .studies import Study as Study
    from .system.system import System as System

__version__ = _version()

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
_PUBLIC = "__version__ cases exceptions plots reference studies theory"
__all__ = sorted([*_HOME, *_PUBLIC.split()])


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
