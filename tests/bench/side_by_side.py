"""Independent runs in parallel on all cores; only for deterministic figures."""

import multiprocessing
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from typing import TypeVar

Case = TypeVar("Case")
Outcome = TypeVar("Outcome")


def side_by_side(run: Callable[[Case], Outcome], cases: Iterable[Case]) -> list[Outcome]:
    """Results of a function for each case, in order; function and cases are sent to other processes."""
    return list(_pool().map(run, cases))


@cache
def _pool() -> ProcessPoolExecutor:
    """A pool of one process per core, which ends with this process."""
    return ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn"))
