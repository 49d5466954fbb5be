"""How much memory this process may still use, and the refusal of work that needs more."""

from __future__ import annotations

import contextlib

from ..exceptions import ResourceError


def need(what: str, needed_bytes: int) -> None:
    """Raise `ResourceError` if `what` needs more than 0.8 of the memory that is left."""
    if needed_bytes < 2**24:  # not worth asking the operating system
        return
    left = memory_left()
    if left is None or needed_bytes <= 0.8 * left:
        return
    limit = int(0.8 * left)
    raise ResourceError(
        f"{what} needs {_gib(needed_bytes)} GiB, but only {_gib(limit)} GiB may be used",
        needed_bytes,
        limit,
    )


def memory_left() -> int | None:
    """Return how many more bytes this process may use, None where nothing can be found out.

    The least of: address-space limit minus what is mapped; the limits of the control groups
    (versions 1 and 2, with all parents) minus their use; what the machine has available. Each
    source is optional: on macOS and Windows most of them do not exist and are skipped.
    """
    found: list[int] = []
    for source in (_address_space_left, _cgroups_left, _machine_left):
        with contextlib.suppress(OSError, ValueError):  # a kernel that words its files otherwise
            found += source()
    return max(0, min(found)) if found else None


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
        # Inside a container the named group may not be visible; then only the root remains.
        for depth in range(len(parts), -1, -1):
            folder = "/".join([root, *parts[:depth]])
            limit, used = _text(f"{folder}/{names[0]}"), _text(f"{folder}/{names[1]}")
            if not (limit.strip().isdigit() and used.strip().isdigit()):
                continue  # "max", or no such file
            stat = dict(s.split() for s in _text(f"{folder}/memory.stat").splitlines())
            # Files in the page cache count as use, but are given back when memory is short.
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
