"""A lockstep run with its progress bar, and with the dashboard beside it."""

from robrain.deploy.command_line.process_options import above_zero, until_explored
from robrain.deploy.command_line.terminal import say
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.children import Children
from robrain.deploy.processes.dashboard_process import continue_with_recording
from robrain.deploy.processes.live_process import LiveStop
from robrain.deploy.run.preparing import Preparing
from robrain.deploy.run.run_display import run_display, show_result
from robrain.deploy.run.run_options import RunOptions, Watched
from robrain.sim.lockstep.result import RunResult
from robrain.sim.scenarios.driving import Progress
from robrain.sim.scenarios.scenario import Scenario

WATCHING_SPEED = 5.0


def run_scenario(scenario: Scenario, options: RunOptions, children: Children, watched: Watched | None) -> RunResult:
    """Run a scenario as its options say.

    Args:
        scenario: what is run.
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
            say(f"{scenario.name}: {scenario.robots} robots, {scenario.motes} motes, seed {scenario.seed}")
        with run_display(target, quiet=options.quiet) as display:

            def show(progress: Progress) -> None:
                display.show(progress)
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
        should_stop = LiveStop()  # before the user is told of Ctrl-C: the default handler ends with another status
        say(f"{page.url} now shows the recording: Ctrl-C ends it")
        should_stop.wait()
    return result
