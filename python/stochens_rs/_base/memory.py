"""The memory that this process may still use; work that needs more is refused."""

from __future__ import annotations

import contextlib
import functools
import inspect
import math
import sys
from types import FunctionType
from typing import Any

from ..exceptions import ResourceError

# Share of the memory left that one result may take; the rest is for what else the process does.
_SHARE = 0.8
# Bytes below which the operating system is not asked: asking takes longer than allocating them.
_SMALL = 2**24
# Bytes above which the limit of a control group is none: version 1 has 2^63 less a page for that.
_NO_LIMIT = 2**60
# Methods that users call without their names.
_UNNAMED = {"__init__", "__call__", "__eq__", "__len__", "__repr__", "__reduce__", "_repr_html_"}
_own: set[str] = set()  # modules whose public callables raise `ResourceError` alone


def need(what: str, needed_bytes: int) -> None:
    """Raise `ResourceError` if `what` needs more than 0.8 of the memory that is left."""
    if needed_bytes < _SMALL:
        return
    left = memory_left()
    if left is None or needed_bytes <= _SHARE * left:
        return
    limit = int(_SHARE * left)
    raise ResourceError(
        f"{what} needs {_gib(needed_bytes)} GiB, but only {_gib(limit)} GiB may be used",
        needed_bytes,
        limit,
    )


def own_errors(package: str) -> None:
    """Let all public callables of `package` raise `ResourceError` for every lack of memory.

    They are those in ``__all__`` of the modules that are loaded, with the methods of the classes.
    """
    for place in [name for name in sys.modules if name.startswith(package + ".")]:
        names = getattr(sys.modules[place], "__all__", ()) if place not in _own else ()
        _own.add(place)
        for value in [getattr(sys.modules[place], name) for name in names]:
            if inspect.isclass(value) and not issubclass(value, Exception):
                for one in value.__mro__:
                    if one.__module__.startswith(package):
                        _own_methods(one)
            elif isinstance(value, FunctionType) and value.__module__.startswith(package):
                home = sys.modules[value.__module__]  # where pickles look for it
                for module in (home, sys.modules[place]):
                    setattr(module, value.__name__, _own_error(vars(home)[value.__name__]))


def _own_methods(owner: type) -> None:
    for name, member in list(vars(owner).items()):
        if name.startswith("_") and name not in _UNNAMED:
            continue
        if isinstance(member, FunctionType):
            setattr(owner, name, _own_error(member))
        elif isinstance(member, (classmethod, staticmethod)):
            setattr(owner, name, type(member)(_own_error(member.__func__)))
        elif isinstance(member, property) and member.fget:
            setattr(owner, name, member.getter(_own_error(member.fget)))
        elif isinstance(member, functools.cached_property):
            member.func = _own_error(member.func)


def _own_error(function: Any) -> Any:
    if not isinstance(function, FunctionType) or hasattr(function, "_own_error"):
        return function
    own = _resource_error  # a name of this function: `call` has other globals

    def call(*args: Any, **kwargs: Any) -> Any:
        try:
            return function(*args, **kwargs)
        except MemoryError as error:
            raise own(function, error) from None

    # the globals of `function`: doctest finds examples by them
    code, bound = call.__code__, call.__closure__
    made = FunctionType(code, function.__globals__, function.__name__, None, bound)
    made._own_error = True  # type: ignore[attr-defined]
    return functools.update_wrapper(made, function)


def _resource_error(function: FunctionType, error: MemoryError) -> ResourceError:
    """`error`, or what took its place: which call, and how many bytes for what."""
    if isinstance(error, ResourceError):
        return error
    try:
        shape, dtype = getattr(error, "shape", None), getattr(error, "dtype", None)
        if shape is None or dtype is None:
            return ResourceError(f"`{function.__qualname__}` needs more memory than there is")
        needed = math.prod(shape) * dtype.itemsize
        entries = f"{' x '.join(map(str, shape))} entries of {dtype}"
        return ResourceError(
            f"`{function.__qualname__}` needs {_gib(needed)} GiB for {entries}: there is no more",
            needed,
        )
    except MemoryError:  # not even for the text
        return ResourceError()


def memory_left() -> int | None:
    """Return how many more bytes this process may use, or None if that cannot be determined.

    The minimum of: the address-space limit minus what is mapped; the limits of the control groups
    (versions 1 and 2, with all parents) minus their use; the available memory of the machine.
    Sources that do not exist, as on macOS and Windows, are skipped.
    """
    return min(left_by_source().values(), default=None)


def left_by_source() -> dict[str, int]:
    """Bytes that this process may still use by each limit that there is."""
    found: dict[str, int] = {}
    for name, source in (
        ("address space", _address_space_left),
        ("control groups", _cgroups_left),
        ("machine", _machine_left),
    ):
        with contextlib.suppress(OSError, ValueError):  # another format of these files
            if left := source():
                found[name] = max(0, min(left))
    return found


def _address_space_left() -> list[int]:
    try:
        import resource
    except ImportError:  # Windows
        return []
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    if soft == resource.RLIM_INFINITY:
        return []
    pages = _text("/proc/self/statm").split()
    mapped = int(pages[0]) * resource.getpagesize() if pages else 0
    return [soft - mapped]


def _cgroups_left() -> list[int]:
    found = []
    for line in _text("/proc/self/cgroup").splitlines():
        _, controllers, group = line.split(":", 2)
        if controllers == "":
            root, names = "/sys/fs/cgroup", ("memory.max", "memory.current", "inactive_file")
        elif "memory" in controllers.split(","):
            root = "/sys/fs/cgroup/memory"
            names = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
        else:
            continue
        parts = [part for part in group.split("/") if part]
        # Inside a container the named group may not be visible, only the root.
        for depth in range(len(parts), -1, -1):
            folder = "/".join([root, *parts[:depth]])
            limit, used = _text(f"{folder}/{names[0]}"), _text(f"{folder}/{names[1]}")
            if not (limit.strip().isdigit() and used.strip().isdigit()):
                continue  # "max", or no such file
            if int(limit) > _NO_LIMIT:
                continue
            stat = dict(s.split() for s in _text(f"{folder}/memory.stat").splitlines())
            # Inactive files in the page cache count as use, but the kernel frees them if needed.
            found.append(int(limit) - int(used) + int(stat.get(names[2], 0)))
    return found


def _machine_left() -> list[int]:
    for line in _text("/proc/meminfo").splitlines():
        if line.startswith("MemAvailable:"):
            return [int(line.split()[1]) * 1024]
    return []


def _text(path: str) -> str:
    with contextlib.suppress(OSError), open(path, encoding="ascii", errors="replace") as file:
        return file.read()
    return ""


def _gib(count: int) -> str:
    return f"{count / 2**30:.4g}"
