"""What a run waits for before its first step: compiled kernels, and the page of its dashboard."""

import math
import os
import time
from collections.abc import Mapping
from contextlib import ExitStack
from typing import Self

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn

from robrain.deploy.commands.terminal import both_at_a_terminal, console, print_line, say
from robrain.deploy.processes.dashboard_process import StartingPage
from robrain.deploy.run.kernel_compiler import CompileProgress, KernelCompiler
from robrain.deploy.run.kernels import PARTS, are_cached, load_kernels, prepare_kernels
from robrain.protocol.model.warm_up import Part
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.lockstep.pacing import StopOnInterrupt

LOOK_S = 0.05
SHOWN_S = 0.25
"""Period of the picture that viewers get."""
PROCESSES = 2
WORDS = "preparing: compiling the navigation, once on this computer"
NOTHING = CompileProgress(0, 0, None)


class Preparing:
    """Compiles what is not compiled yet while a run is set up and shown. Use it in a `with` block.

    Args:
        page: of the dashboard, or None.
        quiet: report nothing.

    """

    def __init__(self, page: StartingPage | None, *, quiet: bool = False) -> None:
        self._page = page
        self._url = ""
        self._quiet = quiet
        self._compiler: KernelCompiler | None = None
        self._closing = ExitStack()
        self._began_s = time.monotonic()

    def begin(self) -> None:
        """Load the kernels; if one is not compiled that a run needs at its start, compile beside this process."""
        if not load_kernels():
            self._began_s = time.monotonic()
            self._compile(PARTS)
            if not self._quiet and not console.is_terminal:
                say(f"{WORDS}: half a minute or so")

    def _compile(self, parts: Mapping[str, Part]) -> None:
        self._compiler = self._closing.enter_context(KernelCompiler(parts, min(PROCESSES, os.cpu_count() or 1)))

    def wait(self, run: LockstepRun) -> None:
        """Show where everything is until the run can begin, and print the page's address when it is served.

        Raises:
            ChildFailed: the dashboard did not start.
            KeyboardInterrupt: Ctrl-C.

        """
        picture = run.start_picture()
        shown_s = -math.inf
        with StopOnInterrupt() as interrupt, _CompilingDisplay(quiet=self._quiet) as display:
            while self._waits_for_page() or self._is_compiling:
                if interrupt.requested:
                    raise KeyboardInterrupt
                if self._compiler is not None:
                    self._compiler.step()
                if time.monotonic() - shown_s > SHOWN_S:
                    shown_s = time.monotonic()
                    progress = NOTHING if self._compiler is None else self._compiler.progress
                    picture.show(*progress)
                    display.show(progress)
                time.sleep(LOOK_S)
        if self._compiler is not None:
            self._tell(self._compiler)
            prepare_kernels(quiet=self._quiet, only_at_start=True)
        elif not are_cached():  # a run before has ended while the rest was compiled
            self._compile({name: part for name, part in PARTS.items() if not part.at_start})
        picture.close()

    def close(self) -> None:
        """Compile no more."""
        self._closing.close()
        self._compiler = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _waits_for_page(self) -> bool:
        """Whether the page is not served yet; prints its address as soon as it is."""
        if self._page is None or self._url:
            return False
        self._url = self._page.url
        if self._url and not self._quiet:
            print_line(f"dashboard: {self._url}")
        return not self._url

    @property
    def _is_compiling(self) -> bool:
        return self._compiler is not None and not self._compiler.is_done

    def _tell(self, compiler: KernelCompiler) -> None:
        if self._quiet:
            return
        if compiler.failure:
            say(f"{compiler.failure}: compiling the rest in this one")
        else:
            say(f"the navigation is compiled after {time.monotonic() - self._began_s:.0f} s; the run begins")


class _CompilingDisplay:
    """A bar at a terminal; elsewhere it prints nothing."""

    def __init__(self, *, quiet: bool) -> None:
        columns = (TextColumn("{task.description}"), BarColumn(bar_width=30), MofNCompleteColumn())
        self._progress = Progress(
            *columns,
            TextColumn("{task.fields[left]}"),
            console=console,
            transient=True,
            disable=quiet or not console.is_terminal,
            redirect_stdout=both_at_a_terminal(),
        )
        self._bar: TaskID | None = None

    def show(self, progress: CompileProgress) -> None:
        """Draw how far the compiling is."""
        if not progress.parts:
            return
        if self._bar is None:
            self._bar = self._progress.add_task(WORDS, total=progress.parts, left="")
        left = "" if progress.left_s is None else f"about {math.ceil(progress.left_s)} s left"
        self._progress.update(self._bar, completed=progress.ready, left=left)

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()
