"""`save` and `load` of what is kept in state files."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, ClassVar

from ..exceptions import InputError, InputTypeError, StateError
from . import state_file
from .files import PathLike

if TYPE_CHECKING:
    from typing_extensions import Self


class Durable:
    """Base of the classes that can be saved as named arrays and loaded again."""

    __slots__ = ()

    _kind: ClassVar[str]

    def _to_sections(self) -> dict[str, Any]:
        raise NotImplementedError

    @classmethod
    def _from_sections(cls, sections: dict[str, Any]) -> Self:
        raise NotImplementedError

    def save(self, path: PathLike) -> int:
        """Save to a file.

        Parameters
        ----------
        path : path
            The file; the previous state is kept as ``<path>.prev``.

        Returns
        -------
        int
            The generation: 1 for the first state at this path, then one more each time. The state
            is on the disk when this returns.

        Raises
        ------
        StateError
            If the file at `path` is something else than an earlier state of this kind.
        StateLockedError
            If another thread or process is saving there, or a run has it as its checkpoint.
        StateIOError
            If writing fails, for example for lack of space or permission. The previous states are
            not changed.
        InputError, InputTypeError
            If `path` is not a path.

        Notes
        -----
        The format is safetensors, with a version and a SHA-256 digest; loading executes nothing
        (``docs/state-format.md``). The file is written under another name, synced and renamed, and
        the directory is synced: a complete state is on the disk at any time.

        Examples
        --------
        >>> import tempfile, pathlib, stochens_rs as se
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "a.state"
        >>> stream = se.Stream(([[2.0]], [[1.0]]), [1.0], [0.0], rng=1)
        >>> stream.step(1000)
        >>> stream.save(path)
        1
        >>> se.Stream.load(path).steps
        1000
        """
        return state_file.save(path, self._kind, self._to_sections())

    @classmethod
    def load(cls, path: PathLike) -> Self:
        """Load what was saved.

        Parameters
        ----------
        path : path
            The file.

        Returns
        -------
        Self
            With the same bits in every field; a stream continues exactly as it.

        Raises
        ------
        StateError
            If neither the file nor the previous generation can be used: damaged, of another kind,
            of a newer version, or with contents that cannot be.
        StateNotFoundError
            If neither exists.
        StateIOError
            If reading fails.
        InputError, InputTypeError
            If `path` is not a path.

        Warns
        -----
        StateRecoveredWarning
            If the file is missing or damaged and the previous generation was loaded.

        Notes
        -----
        Nothing is written. Checked are the sizes (before memory is allocated), the digest, and the
        numbers: finite; of a stream, estimates in the hull of the realizations, and the key and the
        problem those of the digest; of a model, the triangle that of the data, and all that
        `identify` checks; of other results, the types of their fields and all that their
        constructors check.

        Examples
        --------
        See `save`.
        """
        _, sections = state_file.load(path, cls._kind)
        try:
            return cls._from_sections(sections)
        except KeyError as error:
            raise StateError(f"{os.fspath(path)} must have an array {error}, got none") from error
        except (InputError, InputTypeError) as error:
            raise StateError(f"{os.fspath(path)}: {error}") from error


def nothing_left(sections: dict[str, Any]) -> None:
    """Refuse arrays that nothing has taken."""
    if sections:
        raise InputError(f"a file of this kind has no array '{min(sections)}'")
