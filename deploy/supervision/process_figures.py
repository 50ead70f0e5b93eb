"""CPU and memory of a process of this machine, and how long it waited for a core: from Linux's /proc."""

import os
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

PROC = Path("/proc")
PERIOD_S = 1.0
"""Time over which CPU is averaged, at least."""
MEGABYTE = 1024 * 1024


class Figures(NamedTuple):
    """What a process takes."""

    cpu_share: float | None
    """Of one core, over the last second; None if unknown."""
    memory_mb: float | None
    """Resident, MiB; None if unknown."""


UNKNOWN = Figures(None, None)


class ProcessFigures:
    """Follows one process.

    Args:
        pid: its process id.
        proc: where Linux tells of processes.

    """

    def __init__(self, pid: int, proc: Path = PROC) -> None:
        self._folder = proc / str(pid)
        self._before: tuple[float, float] | None = None
        self._last = UNKNOWN

    def at(self, now_s: float) -> Figures:
        """What it takes now; the last figures if they are less than a second old.

        Args:
            now_s: a clock that only goes forward, s.

        """
        if self._before is not None and now_s - self._before[0] < PERIOD_S:
            return self._last
        try:
            cpu_s, memory_mb = _read(self._folder)
        except (OSError, ValueError, IndexError):
            self._before, self._last = None, UNKNOWN
            return UNKNOWN
        share = None if self._before is None else max(cpu_s - self._before[1], 0.0) / (now_s - self._before[0])
        self._before, self._last = (now_s, cpu_s), Figures(share, memory_mb)
        return self._last


def commands_beside(pid: int, proc: Path = PROC) -> list[tuple[int, list[str]]]:
    """The `robrain` processes with the same parent as a process: process ids and arguments.

    Args:
        pid: id of the process.
        proc: the folder /proc.

    """
    found = []
    with suppress(OSError, ValueError, IndexError):
        parent = _parent(proc / str(pid))
        for folder in proc.iterdir():
            with suppress(OSError, ValueError, IndexError):  # it may end meanwhile
                if folder.name.isdigit() and _parent(folder) == parent:
                    words = (folder / "cmdline").read_text().rstrip("\0").split("\0")
                    program = [Path(word).name in ("robrain", "robrain.cli") for word in words].index(True)
                    found.append((int(folder.name), words[program + 1 :]))
    return found


def _parent(folder: Path) -> int:
    return int((folder / "stat").read_text().rpartition(")")[2].split()[1])


class CoreWait:
    """How long a process could not run because other processes had the cores.

    Args:
        pid: its process id.
        proc: where Linux tells of processes.

    """

    def __init__(self, pid: int, proc: Path = PROC) -> None:
        self._tasks = proc / str(pid) / "task"
        self._before: dict[str, int] | None = None

    def since_last_s(self) -> float:
        """Seconds since the last call, of the thread that waited longest; 0 in the first call and where unknown.

        All threads count: the main one may wait for another that holds the interpreter's lock and waits for a core.
        """
        before, self._before = self._before, self._read_ns()
        if before is None:
            return 0.0
        return max((waited - before.get(thread, waited) for thread, waited in self._before.items()), default=0) / 1e9

    def forget(self) -> None:
        """Let the next call be the first again."""
        self._before = None

    def _read_ns(self) -> dict[str, int]:
        waited: dict[str, int] = {}
        with suppress(OSError):
            for thread in self._tasks.iterdir():
                with suppress(OSError, ValueError, IndexError):
                    # Time on a core, time waited for one, both ns, and number of turns: proc/schedstat of the kernel.
                    waited[thread.name] = int((thread / "schedstat").read_text().split()[1])
        return waited


def _read(folder: Path) -> tuple[float, float]:
    """CPU seconds since the process began, and resident MiB."""
    # The name, in brackets, may hold blanks; utime and stime are fields 14 and 15 of proc_pid_stat(5).
    fields = (folder / "stat").read_text().rpartition(")")[2].split()
    ticks = int(fields[11]) + int(fields[12])
    pages = int((folder / "statm").read_text().split()[1])
    return ticks / os.sysconf("SC_CLK_TCK"), pages * os.sysconf("SC_PAGE_SIZE") / MEGABYTE
