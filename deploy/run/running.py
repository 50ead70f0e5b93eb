"""`robrain run` and `robrain demo`: a lockstep run with its progress bar, and with the dashboard beside it."""

from pathlib import Path

import msgspec

from robrain.deploy.commands.options import above_zero, until_explored
from robrain.deploy.commands.terminal import say
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.children import Children
from robrain.deploy.processes.dashboard_process import StartingPage, begin_dashboard, go_on_with_recording
from robrain.deploy.processes.live_process import LiveStop
from robrain.deploy.run.preparing import Preparing
from robrain.deploy.run.run_display import run_display, show_result
from robrain.protocol.wire.keys import DEFAULT_TEAM
from robrain.sim.lockstep.result import RunResult
from robrain.sim.scenarios.scenario import Scenario

WATCHING_SPEED = 5.0


class RunOptions(msgspec.Struct, frozen=True, kw_only=True):
    """The options of a run, as the command line gives them."""

    until: str | None = None
    time_limit_s: float | None = None
    speed: float | None = None
    record: Path | None = None
    dashboard: bool = False
    port: int | None = None
    quiet: bool = False
    """Say nothing but errors."""
    stay: bool = False
    """Keep the dashboard up after the run, until Ctrl-C: it then shows the recording."""


def run_scenario(scenario: Scenario, options: RunOptions) -> RunResult:
    """Run a scenario as its options say.

    Raises:
        RobrainError: an option or the scenario is wrong, in words.

    """
    until = until_explored(options.until)
    above_zero("--time-limit", options.time_limit_s)
    speed = options.speed if options.speed is not None else WATCHING_SPEED if options.dashboard else 0.0
    if speed < 0:
        raise UsageError(f"--speed {speed:g}: expected 0 (as fast as possible) or more")
    target = until if until is not None else scenario.until_explored
    page: StartingPage | None = None
    with Children() as children, Preparing(quiet=options.quiet) as preparing:

        def open_dashboard(endpoints: list[str]) -> None:
            nonlocal page
            if options.dashboard:
                page = begin_dashboard(children, endpoints[0], DEFAULT_TEAM, options.port)
            preparing.begin()

        if not options.quiet:
            say(f"{scenario.name}: {scenario.robots} robots, {scenario.motes} motes, seed {scenario.seed}")
        with run_display(target, quiet=options.quiet) as display:
            result = scenario.run(
                until_explored=until,
                time_limit_s=options.time_limit_s,
                speed=speed,
                record=options.record,
                listen="tcp/127.0.0.1:0" if options.dashboard else None,
                on_progress=display.show,
                on_open=open_dashboard,
                before_start=lambda run: preparing.wait(run, page),
            )
        if not options.quiet:
            show_result(result)
        if options.stay and page is not None and options.record is not None and result.ended != "interrupted":
            preparing.close()
            go_on_with_recording(children, page.url, options.record)
            _stay(page.url)
    return result


def _stay(url: str) -> None:
    import time

    should_stop = LiveStop()  # before the user is told of Ctrl-C: the default handler ends with another status
    say(f"{url} now shows the recording: Ctrl-C ends it")
    while not should_stop():
        time.sleep(0.1)
