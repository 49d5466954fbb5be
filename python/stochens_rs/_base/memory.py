"""The memory that this process may still use; work that needs more is refused."""

from __future__ import annotations

import contextlib

from ..exceptions import ResourceError

# Share of the memory left that one result may take; the rest is for what else the process does.
_SHARE = 0.8
# Bytes below which the operating system is not asked: asking takes longer than allocating them.
_SMALL = 2**24
# Bytes above which the limit of a control group is none: version 1 has 2^63 less a page for that.
_NO_LIMIT = 2**60


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
