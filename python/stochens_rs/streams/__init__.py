"""One realization at a time: a control that gets better, its certificate, and its files."""

from .data_stream import DataStream
from .records import Confidence, StreamRun, Trace
from .stream import Stream

__all__ = ["Confidence", "DataStream", "Stream", "StreamRun", "Trace"]
