"""What a run waits for before its first step: compiled kernels, and the page of its dashboard."""

import math
import os
import time
from collections.abc import Mapping
from contextlib import ExitStack
from typing import Self

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID

from robrain.deploy.commands.terminal import both_at_a_terminal, console, say, text_column
from robrain.deploy.run.kernel_compiler import CompileProgress, KernelCompiler
from robrain.deploy.run.kernels import PARTS, are_cached, load_kernels, prepare_kernels
from robrain.deploy.run.run_options import Watched
from robrain.protocol.model.warm_up import Part
from robrain.protocol.wire.clock import VirtualClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.keys import DEFAULT_TEAM
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.lockstep.pacing import StopOnInterrupt
from robrain.sim.lockstep.start_picture import StartPicture
from robrain.sim.world.world import World

LOOK_S = 0.05
SHOWN_S = 0.25
"""Period of the picture that viewers get."""
PROCESSES = 2
LATER_S = 10.0
"""From a run's start until what it does not need at first is compiled: until then a browser loads the page."""
WORDS = "preparing: compiling the navigation, once on this computer"
NOTHING = CompileProgress(0, 0, None)


class Preparing:
    """Compiles what is not compiled yet while a run is set up and shown. Use it in a `with` block.

    Args:
        watched: the dashboard's page and the session on which it follows the run, or None.
        quiet: report nothing.

    """

    def __init__(self, watched: Watched | None, *, quiet: bool = False) -> None:
        self._watched = watched
        self._picture: StartPicture | None = None
        self._quiet = quiet
        self._compiler: KernelCompiler | None = None
        self._closing = ExitStack()
        self._began_s = time.monotonic()
        self._later_s = math.inf
        """When the parts are begun that a run does not need at first."""

    def begin(self, world: World) -> None:
        """Show where everything is, and load the kernels.

        If one is not compiled that a run needs at its start, begin to compile beside this process.
        """
        self._open_picture(world)
        self._show(NOTHING)
        is_compiled = load_kernels()
        self._show(NOTHING)  # again: the page may not have listened yet
        if not is_compiled:
            self._began_s = time.monotonic()
            self._compile(PARTS)
            if not self._quiet and not console.is_terminal:
                say(f"{WORDS}: half a minute or so")

    def _open_picture(self, world: World) -> None:
        if self._watched is not None:
            # Not of the run's own endpoints: what is not set up yet need not be, to be seen.
            endpoint = Endpoint(self._watched.session, DEFAULT_TEAM, VirtualClock(), Drive.LOCKSTEP)
            self._picture = StartPicture(endpoint, world)
            self._closing.callback(self._close_picture)

    def _close_picture(self) -> None:
        picture, self._picture = self._picture, None
        if picture is not None:
            picture.close()

    def _show(self, progress: CompileProgress) -> None:
        if self._picture is not None:
            self._picture.show(*progress)

    def _compile(self, parts: Mapping[str, Part]) -> None:
        self._compiler = self._closing.enter_context(KernelCompiler(parts, min(PROCESSES, os.cpu_count() or 1)))

    def wait(self, _run: LockstepRun) -> None:
        """Show where everything is until the run can begin.

        Raises:
            ChildFailed: the dashboard did not start.
            KeyboardInterrupt: Ctrl-C.

        """
        self._show(NOTHING)
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
                    self._show(progress)
                    display.show(progress)
                time.sleep(LOOK_S)
        if self._compiler is not None:
            self._tell(self._compiler)
            prepare_kernels(quiet=self._quiet, only_at_start=True)
        elif not are_cached():  # a run before has ended while the rest was compiled
            self._later_s = time.monotonic() + LATER_S
        self._close_picture()

    def step(self) -> None:
        """While the run goes on: compile what it did not need at first."""
        if time.monotonic() >= self._later_s:
            self._later_s = math.inf
            self._compile({name: part for name, part in PARTS.items() if not part.at_start})
        if self._compiler is not None:
            self._compiler.step()

    def close(self) -> None:
        """Show and compile no more."""
        self._closing.close()
        self._compiler = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _waits_for_page(self) -> bool:
        """Whether the page is not served yet."""
        return self._watched is not None and not self._watched.page.url

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
        columns = (text_column("{task.description}"), BarColumn(bar_width=30), MofNCompleteColumn())
        self._progress = Progress(
            *columns,
            text_column("{task.fields[left]}"),
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
