"""Controls that are updated with every realization, and their state files."""

from .confidence import Confidence
from .data_stream import DataStream
from .records import StreamRun, Trace
from .stream import Stream

__all__ = ["Confidence", "DataStream", "Stream", "StreamRun", "Trace"]
