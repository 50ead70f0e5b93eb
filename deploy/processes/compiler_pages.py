"""Gives back the memory of the compiler's code, which a robot needs only while it loads a kernel.

Kernels come out of numba's cache, through LLVM: 68 MB of its library are in memory afterwards, and nothing runs them
again. They are pages of a file that nobody has changed; a page that is needed after all is there again at once.
"""

import re
import sys
from pathlib import Path
from typing import NamedTuple

LIBRARY = "libllvmlite"
PERIOD_S = 5.0
MADV_DONTNEED = 4
_MAPPING = re.compile(r"(?P<begin>[0-9a-f]+)-(?P<end>[0-9a-f]+) (?P<rights>\S+) \S+ \S+ \S+ +(?P<file>.+)")


class Pages(NamedTuple):
    """A range of addresses."""

    begin: int
    size: int


def unchanged_pages(smaps: str, library: str) -> list[Pages]:
    """What a process has mapped of a library and has not changed, so that it can be read again from its file.

    Args:
        smaps: text of `/proc/PID/smaps`.
        library: how the name of its file begins.

    """
    found: list[Pages] = []
    pages: Pages | None = None
    for line in smaps.splitlines():
        mapping = _MAPPING.fullmatch(line)
        if mapping is not None:
            begin, end = int(mapping["begin"], 16), int(mapping["end"], 16)
            is_its = Path(mapping["file"]).name.startswith(library) and "w" not in mapping["rights"]
            pages = Pages(begin, end - begin) if is_its else None
        elif line.startswith("Anonymous:") and pages is not None and line.split()[1] == "0":
            found.append(pages)  # what the loader has changed is its own copy, and would be lost
    return found


class CompilerPages:
    """Gives the pages back every few seconds, on Linux; elsewhere it does nothing."""

    def __init__(self) -> None:
        self._pages: list[Pages] = []
        self._due_s = PERIOD_S

    def give_back(self, now_s: float) -> None:
        """Do so if it is time.

        Args:
            now_s: since the process became alive.

        """
        if now_s < self._due_s:
            return
        self._due_s = now_s + PERIOD_S
        if not self._pages and "llvmlite.binding" in sys.modules and sys.platform == "linux":
            self._pages = unchanged_pages(Path("/proc/self/smaps").read_text(encoding="utf-8"), LIBRARY)
        if self._pages:
            import ctypes  # llvmlite has loaded it

            libc = ctypes.CDLL(None)
            libc.madvise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
            for pages in self._pages:
                libc.madvise(pages.begin, pages.size, MADV_DONTNEED)
