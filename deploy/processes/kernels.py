"""Compiles the kernels before a run, with a message, because this is slow the first time on a computer."""

import pickle
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from types import ModuleType
from typing import Any

from numba.core import event
from numba.core.dispatcher import Dispatcher
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn

from robrain.algorithms import warm_up as model
from robrain.algorithms.allocation.warm_up import warm_up as warm_up_allocation
from robrain.algorithms.exploration.warm_up import warm_up as warm_up_exploration
from robrain.algorithms.warm_up import KernelPart
from robrain.deploy.command_line.terminal import console, print_progress, text_column
from robrain.sim.warm_up import warm_up as warm_up_arena

COMPILING = "numba:compile"
WORDS = "compiling kernels, once on this computer"
OURS = "robrain."

PARTS: dict[str, KernelPart] = {
    **{name: part for name, part in model.PARTS.items() if part.at_start},
    "simulation": KernelPart(warm_up_arena, at_start=True),
    "exploration": KernelPart(warm_up_exploration, at_start=True),
    "plans": KernelPart(lambda: warm_up_allocation(with_charges=True), at_start=False),
    **{name: part for name, part in model.PARTS.items() if not part.at_start},
}
"""All parts, in the order in which they are compiled."""

_LISTENING: Callable[[str, event.Listener], AbstractContextManager[object]] = event.install_listener


def prepare_kernels(*, quiet: bool = False, only_at_start: bool = False) -> int:
    """Compile the kernels that are not cached, and load the others; report compiling on stderr.

    Args:
        quiet: print no report.
        only_at_start: postpone kernels that a team does not use at first.

    Returns:
        The number of kernels compiled.

    """
    remove_stale_caches(_folders())
    with ExitStack() as closing:
        notice = _Notice(closing, quiet=quiet)
        closing.enter_context(_LISTENING(COMPILING, notice))
        for part in PARTS.values():
            if part.at_start or not only_at_start:
                part.warm_up()
        notice.end()
    return len(notice.compiled)


def load_kernels() -> bool:
    """Load the kernels that a team uses at first; False as soon as one of them is not compiled."""
    remove_stale_caches(_folders())
    with _LISTENING(COMPILING, _Refusal()):
        try:
            for part in PARTS.values():
                if part.at_start:
                    part.warm_up()
        except _NotCompiledError:
            return False
    return True


def are_cached() -> bool:
    """Whether all kernels are compiled for the sources and the version of numba as they are."""
    remove_stale_caches(_folders())
    return all(_is_cached(kernel) for module in _modules_with_kernels() for kernel in _kernels_of(module))


def _is_cached(kernel: Dispatcher) -> bool:
    """Numba has no public function that checks whether its cache has code for the current source of a function."""
    cache: Any = kernel.__dict__["_cache"]
    return bool(cache._cache_file._load_index())


def _folders() -> set[Path]:
    return {Path(str(module.__file__)).parent / "__pycache__" for module in _modules_with_kernels()}


def remove_stale_caches(folders: Iterable[Path]) -> list[Path]:
    """Remove numba's caches that name modules which are gone: numba fails at them instead of compiling again.

    Returns:
        The removed files.

    """
    removed = []
    for index in sorted(path for folder in folders for path in folder.glob("*.nbi")):
        try:
            with index.open("rb") as file:
                pickle.load(file)  # numba's version
                pickle.load(file)
        except (ImportError, AttributeError):
            index.unlink(missing_ok=True)
            removed.append(index)
    return removed


class _NotCompiledError(Exception):
    """A kernel would have to be compiled."""


class _Refusal(event.Listener):
    """Ends each process that calls a kernel that is not compiled."""

    def on_start(self, event: event.Event) -> None:
        """Numba starts to compile a function."""
        raise _NotCompiledError

    def on_end(self, event: event.Event) -> None:
        """Numba has compiled a function."""


class _Notice(event.Listener):
    """Receives numba's compile events, which kernels loaded from the cache do not cause."""

    def __init__(self, closing: ExitStack, *, quiet: bool) -> None:
        self.compiled: set[int] = set()
        self._closing = closing
        self._quiet = quiet
        self._began_s = 0.0
        self._progress: Progress | None = None

    def on_start(self, event: event.Event) -> None:
        """Numba starts to compile a function."""
        if not self._began_s:
            self._began_s = time.monotonic()
            self._begin()

    def on_end(self, event: event.Event) -> None:
        """Numba has compiled a function."""
        self.compiled.add(id(event.data["dispatcher"]))
        if self._progress is not None:
            self._progress.update(self._progress.task_ids[0], completed=len(self.compiled), total=_all_kernels())

    def end(self) -> None:
        """All kernels are ready."""
        if self._began_s and not self._quiet and self._progress is None:
            print_progress(f"compiled {len(self.compiled)} kernels in {time.monotonic() - self._began_s:.0f} s")

    def _begin(self) -> None:
        if self._quiet:
            return
        if not console.is_terminal:
            print_progress(f"{WORDS}: half a minute or so")
            return
        bar = (BarColumn(bar_width=30), MofNCompleteColumn(), TimeElapsedColumn())
        columns = (text_column("{task.description}"), *bar)
        self._progress = self._closing.enter_context(Progress(*columns, console=console, transient=True))
        self._progress.add_task(WORDS, total=_all_kernels())


def _all_kernels() -> int:
    """Number of kernels in loaded modules; slightly too high, as a few are only compiled as part of others."""
    return len({id(one) for module in _modules_with_kernels() for one in _kernels_of(module)})


def _modules_with_kernels() -> list[ModuleType]:
    modules = [module for name, module in list(sys.modules.items()) if name.startswith(OURS)]
    return [module for module in modules if _kernels_of(module)]


def _kernels_of(module: ModuleType) -> list[Dispatcher]:
    return [one for one in vars(module).values() if isinstance(one, Dispatcher)]
