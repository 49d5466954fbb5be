"""Threads, progress and memory of long calls."""

from __future__ import annotations

import _thread
import functools
import inspect
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from types import FunctionType
from typing import Any, TypeAlias, TypeVar

import numpy as np

from ..exceptions import InputTypeError, ResourceError
from . import validation
from .reading import warn as warn
from .validation import show

T = TypeVar("T")

# Seconds between two looks for signals: on Windows, waiting for a thread does not notice them.
_PAUSE = 0.001
_BEGIN = 1.0  # seconds that a thread gets to begin

VARIABLE = "STOCHENS_NUM_THREADS"
_MOST = 1024  # threads of one call
_limit: int | None = None
_single = 0  # how many `one_thread` blocks are open, in all threads together
_single_lock = threading.Lock()


def set_num_threads(threads: int | None) -> None:
    """Set how many threads one call may use.

    The results are the same bits with any number of threads. Each call starts and joins its own
    threads, so the process can be forked between calls.

    Parameters
    ----------
    threads : int or None
        1 to 1024. None for the default: the environment variable ``STOCHENS_NUM_THREADS`` if it
        is a whole number, otherwise the number of processors this process may use.

    Raises
    ------
    SizeError, InputTypeError
        If `threads` is not such a number.

    Examples
    --------
    >>> import stochens_rs as se
    >>> se.set_num_threads(2)
    >>> se.get_num_threads()
    2
    >>> se.set_num_threads(None)
    """
    global _limit
    _limit = None if threads is None else validation.size("threads", threads, maximum=_MOST)


def get_num_threads() -> int:
    """Return how many threads one call may use (see `set_num_threads`).

    Returns
    -------
    int
        At least 1.

    Examples
    --------
    >>> import stochens_rs as se
    >>> se.get_num_threads() >= 1
    True
    """
    return threads_by()[0]


def threads_by() -> tuple[int, str]:
    """How many threads one call may use, and what says so."""
    if _single:
        return 1, "a worker"
    if _limit is not None:
        return _limit, "set_num_threads"
    asked = os.environ.get(VARIABLE, "")
    if asked.isdecimal() and len(asked) <= 4 and int(asked) > 0:
        return min(int(asked), _MOST), VARIABLE
    if hasattr(os, "sched_getaffinity"):
        return max(1, len(os.sched_getaffinity(0))), "processors"
    return os.cpu_count() or 1, "processors"


@contextmanager
def one_thread() -> Iterator[None]:
    """Let each call use one thread: for workers, which are as many as the processors."""
    global _single
    with _single_lock:
        _single += 1
    try:
        yield
    finally:
        with _single_lock:
            _single -= 1


def interruptible(work: Callable[[], T]) -> T:
    """Return ``work()``, computed on a second thread so that Ctrl-C is noticed meanwhile.

    For long NumPy calls, which handle no signal before their end. If a signal handler raises, the
    thread goes on in the background until its work is done.
    """
    found: Future[T] = Future()

    def run() -> None:
        if found.set_running_or_notify_cancel():
            try:
                found.set_result(work())
            except BaseException as error:  # the caller raises it
                found.set_exception(error)

    end = time.monotonic() + _BEGIN
    # not by `Thread.start`, which waits for ever for a thread that has no memory to begin
    with suppress(RuntimeError, MemoryError):  # no thread can be started
        _thread.start_new_thread(run, ())
        while not found.done() and (found.running() or time.monotonic() < end):
            time.sleep(_PAUSE)
    return work() if found.cancel() else found.result()


# None, a flag, or a function f(done, total).
Progress: TypeAlias = bool | Callable[[int, int | None], object] | None


def in_ipython() -> bool:
    """Whether this is an IPython session, in a notebook or in a terminal."""
    ipython = sys.modules.get("IPython")
    return ipython is not None and ipython.get_ipython() is not None


def watched() -> bool:
    """Whether standard error shows lines that are overwritten: no pipe, file or ``TERM=dumb``."""
    if sys.stderr is None:
        return False
    return in_ipython() or (sys.stderr.isatty() and os.environ.get("TERM") != "dumb")


def progress_bar(
    progress: Progress, total: int | None, what: str, unit: str = "it"
) -> AbstractContextManager[Callable[[int], object]]:
    """Turn `progress` into a context that gives a function ``f(done)``.

    There is no bar where it is not `watched`.

    Raises
    ------
    InputTypeError
        At once, if `progress` is neither None, True, False nor callable.
    """
    if not (progress is None or callable(progress) or isinstance(progress, (bool, np.bool_))):
        raise InputTypeError(f"`progress` must be None, a bool or a function, got {show(progress)}")
    if callable(progress):
        return nullcontext(lambda done: progress(done, total))
    return _bar(total, what, unit) if progress and watched() else nullcontext(lambda _: None)


@contextmanager
def _bar(total: int | None, what: str, unit: str) -> Iterator[Callable[[int], object]]:
    from tqdm import tqdm

    with tqdm(total=total, desc=what, unit=unit, unit_scale=True, leave=False) as bar:
        yield lambda done: bar.update(done - bar.n)


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
    text = f"{what} needs {_gib(needed_bytes)} GiB, but only {_gib(limit)} GiB may be used"
    raise ResourceError(text, needed_bytes, limit)


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
        with suppress(OSError, ValueError):  # another format of these files
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
    with suppress(OSError), open(path, encoding="ascii", errors="replace") as file:
        return file.read()
    return ""


def _gib(count: int) -> str:
    return f"{count / 2**30:.4g}"
