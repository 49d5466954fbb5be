"""Optional packages."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def extra(need: str, name: str = "plot") -> Iterator[None]:
    """Around an import of an optional package: name the extra if it is missing."""
    try:
        yield
    except ImportError as error:
        raise ImportError(
            f"{need}: install the extra with `pip install 'stochens_rs[{name}]'`"
        ) from error
