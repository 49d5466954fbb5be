"""Every exception of the package: one family, each member also a built-in error.

Wrong input raises an `InputError` or `InputTypeError`; how a computation ended is a *status*
on its result and raises nothing. All of them can be pickled, so they survive a worker process.
"""

from __future__ import annotations

__all__ = [
    "InputError",
    "InputTypeError",
    "InternalError",
    "NonFiniteError",
    "ResourceError",
    "SeedError",
    "ShapeError",
    "SizeError",
    "SolverError",
    "StateError",
    "StateIOError",
    "StateLockedError",
    "StateNotFoundError",
    "StateRecoveredWarning",
    "StochensError",
    "WeightError",
]


class StochensError(Exception):
    """Base class of everything this package raises on purpose."""


class InputError(StochensError, ValueError):
    """An argument has a permitted type but a value that cannot be used."""


class ShapeError(InputError):
    """An array has the wrong number of dimensions, the wrong shape, or no entries."""


class NonFiniteError(InputError):
    """An argument contains nan or an infinity; the message names the first one."""


class WeightError(InputError):
    """Weights are negative, not finite, do not sum as required, or all are zero."""


class SeedError(InputError):
    """A seed is negative, too large, or a key does not have 32 bytes."""


class SizeError(InputError, OverflowError):
    """A count, or another scalar parameter, lies outside its permitted range."""


class InputTypeError(StochensError, TypeError):
    """An argument has a type (or an array a dtype) that is not accepted."""


class ResourceError(StochensError, MemoryError):
    """A result would need more memory than this process may use; nothing was allocated.

    Parameters
    ----------
    message : str
        One line for the reader.
    needed_bytes : int, optional
        What the result would need [bytes]; None if unknown.
    limit_bytes : int, optional
        What may be used [bytes]; None if unknown.
    """

    def __init__(
        self,
        message: str = "",
        needed_bytes: int | None = None,
        limit_bytes: int | None = None,
    ) -> None:
        super().__init__(message)
        self.needed_bytes = needed_bytes
        self.limit_bytes = limit_bytes


class SolverError(StochensError, RuntimeError):
    """A solver ended without a usable answer; what it had is not thrown away.

    Parameters
    ----------
    message : str
        One line for the reader.
    result : object, optional
        The best iterate and its diagnostics; None if there is nothing.
    """

    def __init__(self, message: str = "", result: object = None) -> None:
        super().__init__(message)
        self.result = result


class StateError(StochensError, ValueError):
    """A file is not a usable state file: foreign, damaged, of another kind, version or content."""


class StateIOError(StochensError, OSError):
    """The system refused an operation on a state file; `errno` and `filename` say which and where.

    Whatever had been saved before can still be loaded.
    """


class StateNotFoundError(StateIOError, FileNotFoundError):
    """There is no state file at this path, and no previous generation of one."""


class StateLockedError(StateIOError, BlockingIOError):
    """Another writer is saving to the same path; nothing was written."""


class StateRecoveredWarning(StochensError, UserWarning):
    """A state file was missing or damaged, and the generation before it was loaded instead."""


class InternalError(StochensError, RuntimeError):
    """A defect of this package (a panic caught in the Rust core): please report it."""
