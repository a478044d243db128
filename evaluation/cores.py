"""On how many cores something runs: kept to one beforehand, and measured while it runs."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
from time import perf_counter, process_time, thread_time

THREADS = "OMP_NUM_THREADS"


def keep_to_one_core() -> bool:
    """Keep this process to one core and its libraries to one thread, unless OMP_NUM_THREADS asks for more.

    To be called before NumPy, PyTorch and Open3D are loaded: they look at the variable, and at the cores that the
    process may use, once.  The variable alone does not do: Open3D (0.20) shares the work of its ICP out with TBB, which
    goes by the cores only.  Where a system cannot bind a process to cores (macOS), only the variable is set.

    Returns:
        whether the process is bound to one core now.
    """
    if os.environ.setdefault(THREADS, "1") != "1" or not hasattr(os, "sched_setaffinity"):
        return False
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    return True


def in_force() -> str:
    """Word what this process is allowed: cores, and threads of OpenMP."""
    n_cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"cores allowed: {n_cores}; {THREADS}: {os.environ.get(THREADS, 'not set')}"


@dataclass(frozen=True, slots=True)
class Effort:
    """What it took to do something once, for so many objects.

    Attributes:
        n: objects.
        wall: time that went by [s].
        cpu: time of processors, of all threads of the process [s].
        own_cpu: that of the calling thread only [s].
    """

    n: int
    wall: float
    cpu: float
    own_cpu: float


@dataclass(frozen=True, slots=True)
class Cost:
    """What an object costs, over many efforts.

    Attributes:
        median_ms: median over efforts of the time for each object [ms].
        mean_ms: all time over all objects [ms].
        cpu_ms: all time of processors over all objects [ms]; with one thread, less than `mean_ms` by the time in which
            the machine did something else.
        threads: time of processors of all threads as a multiple of the calling one's: 1 is one thread.
    """

    median_ms: float
    mean_ms: float
    cpu_ms: float
    threads: float


def effort(action: Callable[[], object], n: int) -> Effort:
    """Do something for n objects, and tell what it took."""
    own_cpu, cpu, wall = thread_time(), process_time(), perf_counter()
    action()
    wall, cpu, own_cpu = perf_counter() - wall, process_time() - cpu, thread_time() - own_cpu
    return Effort(n, wall, cpu, own_cpu)


def cost(efforts: Sequence[Effort]) -> Cost:
    """Sum efforts up; each must be for one object at least, and there must be one at least."""
    n = sum(e.n for e in efforts)
    cpu = sum(e.cpu for e in efforts)
    return Cost(
        median_ms=1e3 * median(e.wall / e.n for e in efforts),
        mean_ms=1e3 * sum(e.wall for e in efforts) / n,
        cpu_ms=1e3 * cpu / n,
        threads=cpu / sum(e.own_cpu for e in efforts),
    )
