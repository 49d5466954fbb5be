"""Controls and models that are updated with every realization or pair, and their state files."""

from .data_stream import DataStream
from .looks import Look, LoopLook
from .model_stream import ModelStream
from .snapshot import Snapshot
from .state import StreamRun, Trace
from .stream import Stream

__all__ = [
    "DataStream",
    "Look",
    "LoopLook",
    "ModelStream",
    "Snapshot",
    "Stream",
    "StreamRun",
    "Trace",
]
