"""Runs that do not depend on each other, on all cores at once; only for figures that are no timings."""

import multiprocessing
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from typing import TypeVar

Case = TypeVar("Case")
Outcome = TypeVar("Outcome")


def side_by_side(run: Callable[[Case], Outcome], cases: Iterable[Case]) -> list[Outcome]:
    """What a run gives for each case, in their order; function and cases go to other processes."""
    return list(_pool().map(run, cases))


@cache
def _pool() -> ProcessPoolExecutor:
    """As many processes as there are cores; they end with this one."""
    return ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn"))
