"""Peak memory of this process, one label at a time on Linux, since its start elsewhere."""

from __future__ import annotations

import ctypes
import resource
from contextlib import suppress
from pathlib import Path


def hand_back() -> None:
    """Give the system back what is held for nothing, as far as it can (GNU's C library)."""
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def forget_peak() -> None:
    """Hand back what earlier labels held, and let the peak of memory count from now on.

    As far as the system can: elsewhere than on Linux the peak is that of the whole process.
    """
    hand_back()
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def peak_memory_mb() -> float:
    """Most memory the process held since its peak was last forgotten, in MiB."""
    with suppress(OSError, ValueError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
