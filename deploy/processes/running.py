"""A lockstep run: its preparation before the first step, its progress, and its result."""

import math
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import NamedTuple, Self

from rich.progress import BarColumn, MofNCompleteColumn, Progress

from robrain.algorithms.warm_up import KernelPart
from robrain.deploy.command_line.options import above_zero, until_explored
from robrain.deploy.command_line.terminal import both_at_a_terminal, console, print_progress, text_column
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.children import Child, Children, continue_with_recording
from robrain.deploy.processes.kernels import PARTS, are_cached, load_kernels, prepare_kernels
from robrain.deploy.processes.live_process import LiveStop
from robrain.deploy.processes.run_display import run_display, show_result
from robrain.deploy.processes.run_options import RunOptions, Watched
from robrain.protocol.clock import VirtualClock
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.lockstep.pacing import StopOnInterrupt
from robrain.sim.lockstep.result import RunResult
from robrain.sim.lockstep.start_picture import StartPicture
from robrain.sim.scenarios.driving import Progress as RunProgress
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.world.world import World

MODULE = "robrain.deploy.processes.compile_worker"
STOP_S = 8.0
"""Time limit for a process to end, which first stores the kernel that it compiles."""
SURE_PARTS = 3
"""Number of finished parts from which the time left is estimated."""


class CompileProgress(NamedTuple):
    """Progress of the parts that a run needs at its start."""

    ready: int
    parts: int
    left_s: float | None
    """Estimate; None if there is none yet."""


class KernelCompiler:
    """Compiles parts of the kernels in processes: first those that a run needs at its start. Use it in a `with` block.

    One of the processes compiles the remaining parts later, because by then the run needs the processors. They end with
    this process in every case: they read from a pipe, which closes with it.

    Args:
        parts: by name, in the order in which they are begun.
        processes: number of parallel compilers.

    """

    def __init__(self, parts: Mapping[str, KernelPart], processes: int) -> None:
        self._at_start = [name for name, part in parts.items() if part.at_start]
        shares = [self._at_start[number::processes] for number in range(processes)]
        shares[0] += [name for name, part in parts.items() if not part.at_start]
        self._ready: set[str] = set()
        self._began_s = time.monotonic()
        self._refusal = ""
        """Reason why a process could not be started."""
        self._workers: list[Child] = []
        try:
            for share in filter(None, shares):
                self._workers.append(Child("compiler", share, self._ready.add, module=MODULE))
        except OSError as error:
            self._refusal = str(error)

    @property
    def is_done(self) -> bool:
        """Whether all kernels that a run needs at its start are compiled, or nobody compiles any more."""
        return self._ready.issuperset(self._at_start) or all(one.status is not None for one in self._workers)

    @property
    def failure(self) -> str:
        """Reason why a process has failed; empty if none has."""
        status = next((one.status for one in self._workers if one.status), 0)
        return self._refusal or (f"a compiling process ended with status {status}" if status else "")

    @property
    def progress(self) -> CompileProgress:
        """How far it is."""
        ready, parts = len(self._ready.intersection(self._at_start)), len(self._at_start)
        passed_s = time.monotonic() - self._began_s
        left_s = passed_s * (parts - ready) / ready if ready >= SURE_PARTS else None
        return CompileProgress(ready, parts, left_s)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.end_input()
        for worker in self._workers:
            worker.end(STOP_S)


POLL_S = 0.05
SHOWN_S = 0.25
"""Period of the picture that viewers get."""
PROCESSES = 2
LATER_S = 10.0
"""From a run's start until the kernels that it needs later are compiled: until then a browser loads the page."""
WORDS = "preparing: compiling the navigation, once on this computer"
NOTHING = CompileProgress(0, 0, None)


class Preparing:
    """Compiles missing kernels while a run is set up and shown. Use it in a `with` block.

    Args:
        watched: the dashboard's page and the session on which it follows the run, or None.
        quiet: print no report.

    """

    def __init__(self, watched: Watched | None, *, quiet: bool = False) -> None:
        self._watched = watched
        self._picture: StartPicture | None = None
        self._quiet = quiet
        self._compiler: KernelCompiler | None = None
        self._closing = ExitStack()
        self._began_s = time.monotonic()
        self._later_s = math.inf
        """Time at which the later parts are begun."""

    def begin(self, world: World) -> None:
        """Show the places of all bodies, and load the kernels.

        If one is not compiled that a run needs at its start, begin to compile beside this process.
        """
        if self._watched is not None:
            # Separate from the run's own endpoints: they need not be set up for the picture.
            endpoint = Endpoint(self._watched.session, DEFAULT_TEAM, VirtualClock(), Drive.LOCKSTEP)
            self._picture = StartPicture(endpoint, world)
        self._show()
        is_compiled = load_kernels()
        self._show()  # again: the page may not have listened yet
        if not is_compiled:
            self._began_s = time.monotonic()
            self._compile(PARTS)
            if not self._quiet and not console.is_terminal:
                print_progress(f"{WORDS}: half a minute or so")

    def wait(self, _run: LockstepRun) -> None:
        """Show the places of all bodies until the run can begin.

        Raises:
            ChildFailed: the dashboard did not start.
            KeyboardInterrupt: Ctrl-C.

        """
        self._show()
        shown_s = -math.inf
        with StopOnInterrupt() as interrupt, _compiling_bar(quiet=self._quiet) as draw:
            while self._waits_for_page() or (self._compiler is not None and not self._compiler.is_done):
                if interrupt.requested:
                    raise KeyboardInterrupt
                if time.monotonic() - shown_s > SHOWN_S:
                    shown_s = time.monotonic()
                    draw(self._show())
                time.sleep(POLL_S)
        if self._compiler is not None:
            self._report(self._compiler)
            prepare_kernels(quiet=self._quiet, only_at_start=True)
        elif not are_cached():  # a run before has ended while the rest was compiled
            self._later_s = time.monotonic() + LATER_S
        self._close_picture()

    def step(self) -> None:
        """During the run: compile the kernels that it did not need at first."""
        if time.monotonic() >= self._later_s:
            self._later_s = math.inf
            self._compile({name: part for name, part in PARTS.items() if not part.at_start})

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._close_picture()
        self._closing.close()
        self._compiler = None

    def _show(self) -> CompileProgress:
        progress = NOTHING if self._compiler is None else self._compiler.progress
        if self._picture is not None:
            self._picture.show(*progress)
        return progress

    def _close_picture(self) -> None:
        picture, self._picture = self._picture, None
        if picture is not None:
            picture.close()

    def _compile(self, parts: Mapping[str, KernelPart]) -> None:
        self._compiler = self._closing.enter_context(KernelCompiler(parts, min(PROCESSES, os.cpu_count() or 1)))

    def _waits_for_page(self) -> bool:
        """Whether the page is not served yet."""
        return self._watched is not None and not self._watched.page.url

    def _report(self, compiler: KernelCompiler) -> None:
        if self._quiet:
            return
        if compiler.failure:
            print_progress(f"{compiler.failure}: compiling the rest in this one")
        else:
            print_progress(f"the navigation is compiled after {time.monotonic() - self._began_s:.0f} s; the run begins")


@contextmanager
def _compiling_bar(*, quiet: bool) -> Iterator[Callable[[CompileProgress], None]]:
    """A bar at a terminal, and the function that draws it; elsewhere it prints nothing."""
    columns = (text_column("{task.description}"), BarColumn(bar_width=30), MofNCompleteColumn())
    is_off = quiet or not console.is_terminal
    with Progress(
        *columns,
        text_column("{task.fields[left]}"),
        console=console,
        transient=True,
        disable=is_off,
        redirect_stdout=both_at_a_terminal(),
    ) as bars:
        bar = bars.add_task(WORDS, left="", visible=False)

        def draw(progress: CompileProgress) -> None:
            left = "" if progress.left_s is None else f"about {math.ceil(progress.left_s)} s left"
            is_begun = progress.parts > 0
            bars.update(bar, visible=is_begun, total=progress.parts, completed=progress.ready, left=left)

        yield draw


WATCHING_SPEED = 5.0


def run_scenario(scenario: Scenario, options: RunOptions, children: Children, watched: Watched | None) -> RunResult:
    """Run a scenario with options.

    Args:
        scenario: the scenario.
        options: of the command line.
        children: of this process; only the page's, if there is one.
        watched: the page; its session is closed with the run.

    Raises:
        RobrainError: an option or the scenario is wrong, in words.

    """
    until = until_explored(options.until)
    above_zero("--time-limit", options.time_limit_s)
    speed = options.speed if options.speed is not None else WATCHING_SPEED if options.dashboard else 0.0
    if speed < 0:
        raise UsageError(f"--speed {speed:g}: expected 0 (as fast as possible) or more")
    target = until if until is not None else scenario.until_explored
    page = watched.page if watched is not None else None
    with Preparing(watched, quiet=options.quiet) as preparing:
        if not options.quiet:
            print_progress(f"{scenario.name}: {scenario.robots} robots, {scenario.motes} motes, seed {scenario.seed}")
        with run_display(target, quiet=options.quiet) as draw:

            def show(progress: RunProgress) -> None:
                draw(progress)
                preparing.step()

            result = scenario.run(
                until_explored=until,
                time_limit_s=options.time_limit_s,
                speed=speed,
                record=options.record,
                session=watched.session if watched is not None else None,
                on_progress=show,
                before_set_up=preparing.begin,
                before_start=preparing.wait,
            )
    if not options.quiet:
        show_result(result)
    if options.stay and page is not None and options.record is not None and result.ended != "interrupted":
        continue_with_recording(children, page.url, options.record)
        should_stop = LiveStop()  # before the line that mentions Ctrl-C: the default handler ends with another status
        print_progress(f"{page.url} now shows the recording: Ctrl-C ends it")
        should_stop.wait()
    return result
