"""The exceptions of the package. Each is a `StochensError` and also a built-in exception.

Wrong input raises an `InputError` or an `InputTypeError`. How a computation ended is the ``status``
of its result instead. All exceptions can be pickled.
"""

from __future__ import annotations


class StochensError(Exception):
    """Base class of the exceptions of this package."""


class InputError(StochensError, ValueError):
    """An argument has a value that cannot be used."""


class ShapeError(InputError):
    """An array has the wrong number of dimensions, the wrong shape, or no entries."""


class NonFiniteError(InputError):
    """An argument contains nan or infinity; the message names the first one."""


class SeedError(InputError):
    """A seed is negative or too large, or a key does not have 32 bytes."""


class SizeError(InputError, OverflowError):
    """A scalar argument lies outside its permitted range."""


class InputTypeError(StochensError, TypeError):
    """An argument has a type, or an array a dtype, that is not accepted."""


class ResourceError(MemoryError, StochensError):
    """A result needs more memory than this process may use; it was not computed.

    Parameters
    ----------
    message : str
        The message.
    needed_bytes : int, optional
        Memory that the result needs [bytes]; None if unknown.
    limit_bytes : int, optional
        Memory that may be used [bytes]; None if unknown.
    """

    def __init__(
        self, message: str = "", needed_bytes: int | None = None, limit_bytes: int | None = None
    ) -> None:
        super().__init__(message)
        self.needed_bytes = needed_bytes
        self.limit_bytes = limit_bytes


class SolverError(StochensError, RuntimeError):
    """A solver ended without a usable result."""


class StateError(StochensError, ValueError):
    """A file is not a usable state file: damaged, or of another kind, version or problem."""


class StateIOError(StochensError, OSError):
    """An operation on a state file failed; see `errno` and `filename`.

    The state saved before can still be loaded.
    """


class StateNotFoundError(StateIOError, FileNotFoundError):
    """There is neither a state file at this path nor a previous generation."""


class StateLockedError(StateIOError, BlockingIOError):
    """Another thread or process is saving to the same path; nothing was written."""


class StateRecoveredWarning(StochensError, UserWarning):
    """A state file was missing or damaged; the previous generation was loaded instead."""


class DataWarning(StochensError, UserWarning):
    """The data speak against an assumption of a model, or do not determine it."""


class InternalError(StochensError, RuntimeError):
    """A defect of this package: a panic in the Rust core. Please report it."""


__all__ = sorted(name for name, one in globals().items() if isinstance(one, type))
