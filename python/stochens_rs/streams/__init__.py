"""Controls and models that are updated with every realization or pair, and their state files."""

from .data_stream import DataStream
from .model_stream import ModelStream
from .snapshot import Look, LoopLook, Snapshot
from .stream import Stream, StreamRun, Trace

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
