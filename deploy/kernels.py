"""Compiling the kernels before a run, with word of it: the first time on a computer that takes a while."""

import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack

from numba.core import event
from numba.core.dispatcher import Dispatcher
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from robrain.coordinator.allocation.warm_up import warm_up as warm_up_allocation
from robrain.coordinator.exploration.warm_up import warm_up as warm_up_exploration
from robrain.deploy.terminal import console, say
from robrain.protocol.model.warm_up import warm_up as warm_up_model

COMPILING = "numba:compile"
WORDS = "compiling kernels, once on this computer"
OURS = "robrain."

_LISTENING: Callable[[str, event.Listener], AbstractContextManager[object]] = event.install_listener


def prepare_kernels(*, quiet: bool = False) -> int:
    """Compile every kernel that is not stored yet, and load the others; says so on stderr where it compiles.

    Args:
        quiet: say nothing.

    Returns:
        How many were compiled.

    """
    with ExitStack() as closing:
        notice = _Notice(closing, quiet=quiet)
        closing.enter_context(_LISTENING(COMPILING, notice))
        for warm_up in (warm_up_model, warm_up_exploration, warm_up_allocation):
            warm_up()
        notice.end()
    return len(notice.compiled)


class _Notice(event.Listener):
    """Hears from numba of each kernel that is compiled, which one that is loaded is not."""

    def __init__(self, closing: ExitStack, *, quiet: bool) -> None:
        self.compiled: set[int] = set()
        self._closing = closing
        self._quiet = quiet
        self._began_s = 0.0
        self._progress: Progress | None = None

    def on_start(self, event: event.Event) -> None:
        """Numba begins to compile a function."""
        if not self._began_s:
            self._began_s = time.monotonic()
            self._begin()

    def on_end(self, event: event.Event) -> None:
        """It has compiled one."""
        self.compiled.add(id(event.data["dispatcher"]))
        if self._progress is not None:
            self._progress.update(self._progress.task_ids[0], completed=len(self.compiled), total=_all_kernels())

    def end(self) -> None:
        """All are there."""
        if self._began_s and not self._quiet and self._progress is None:
            say(f"compiled {len(self.compiled)} kernels in {time.monotonic() - self._began_s:.0f} s")

    def _begin(self) -> None:
        if self._quiet:
            return
        if not console.is_terminal:
            say(f"{WORDS}: half a minute or so")
            return
        columns = (TextColumn("{task.description}"), BarColumn(bar_width=30), MofNCompleteColumn(), TimeElapsedColumn())
        self._progress = self._closing.enter_context(Progress(*columns, console=console, transient=True))
        self._progress.add_task(WORDS, total=_all_kernels())


def _all_kernels() -> int:
    """Kernels in the modules that are loaded; a few are compiled within others only, so this is a little too many."""
    modules = [module for name, module in list(sys.modules.items()) if name.startswith(OURS)]
    return len({id(one) for module in modules for one in vars(module).values() if isinstance(one, Dispatcher)})
