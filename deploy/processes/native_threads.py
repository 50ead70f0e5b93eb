"""How many threads native libraries have in a process, and how much memory these keep; set before they are loaded."""

import ctypes
import os

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Their matrices are small: a pool for each costs memory and wakes processors for nothing."""
ONE_LINK = "(rx: (worker_threads: 1))"
"""Zenoh's runtime for a process with one link, such as an agent; by default two threads receive."""
M_ARENA_MAX, ARENAS = -8, 2
"""Option of glibc's `mallopt`: by default threads share eight heaps a core, which keep most of what was freed in them.
Measured: 118 of the 261 MB of an agent that had run for half an hour."""


def limit_native_threads() -> None:
    """One thread for each native library, few heaps for all threads; what the user has set stays.

    The first holds in processes that this one starts too.
    """
    for name in ONE_THREAD:
        os.environ.setdefault(name, "1")
    if "MALLOC_ARENA_MAX" not in os.environ and hasattr(ctypes.CDLL(None), "mallopt"):
        ctypes.CDLL(None).mallopt(M_ARENA_MAX, ARENAS)


def limit_zenoh_threads() -> None:
    """One receiving thread for the sessions of this process; what the user has set stays."""
    os.environ.setdefault("ZENOH_RUNTIME", ONE_LINK)
