"""What the machine's memory allows: a request that would need more is refused before the memory is taken."""

from __future__ import annotations

import contextlib
import functools
import importlib
import os
from pathlib import Path

from tpmscad.errors import OutOfMemory

USABLE_FRACTION = 0.8
"""Part of the machine's memory that one request may take."""

ASSUMED_MEMORY = 64 * 2**30
"""Bytes assumed where the system does not say."""

UNITS = ("bytes", "KiB", "MiB", "GiB", "TiB")


CONTAINER_LIMITS = (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"))
"""Files in which Linux tells how much memory a container may take."""


@functools.cache
def physical_memory() -> int:
    """Bytes of the machine's memory, or of the part of it that the container or the process may take."""
    try:
        found = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    except (AttributeError, OSError, ValueError):  # Windows has no sysconf
        return ASSUMED_MEMORY
    resource = importlib.import_module("resource")  # which Windows lacks
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    found += [limit] if limit >= 0 else []
    for path in CONTAINER_LIMITS:
        with contextlib.suppress(OSError, ValueError):  # no such file, or "max"
            found.append(int(path.read_text()))
    return min(found)


def format_bytes(count: float) -> str:
    """A number of bytes in the largest unit of which there is at least one."""
    power = 0
    while count >= 1024 and power < len(UNITS) - 1:
        count, power = count / 1024, power + 1
    return f"{count:.3g} {UNITS[power]}"


def require_memory(count: float, bytes_each: float, what: str, remedy: str) -> None:
    """Raise OutOfMemory if `count` things of `bytes_each` bytes, described by `what`, exceed the machine's memory."""
    needed, limit = count * bytes_each, USABLE_FRACTION * physical_memory()
    if not needed <= limit:
        raise OutOfMemory(
            f"this would need about {format_bytes(needed)} of memory, more than the {format_bytes(limit)} that may be used here: "
            f"{what}; {remedy}"
        )
