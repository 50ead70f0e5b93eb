"""Starts a run, and the page that follows it."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from robrain.deploy.command_line.output import print_result
from robrain.deploy.processes.children import DASHBOARD_READY, Children, StartingPage
from robrain.deploy.processes.run_options import RunOptions, Watched
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.wire.session import listening_at, open_lockstep_session

if TYPE_CHECKING:
    from robrain.sim.lockstep.result import RunResult
    from robrain.sim.scenarios.scenario import Scenario


def start_run(choose: Callable[[], "Scenario"], options: RunOptions) -> "RunResult":
    """Run a scenario with options.

    Args:
        choose: loads the scenario.
        options: of the command line.

    Raises:
        RobrainError: an option or the scenario is wrong, in words.

    """
    with Children() as children:
        watched = _begin_page(children, options) if options.dashboard else None
        try:
            # Here: it needs seconds, in which the page's process loads as well.
            from robrain.deploy.processes.running import run_scenario

            return run_scenario(choose(), options, children, watched)
        finally:
            if watched is not None and not watched.session.is_closed():
                watched.session.close()


def _begin_page(children: Children, options: RunOptions) -> Watched:
    # Reported at once: the browser loads while the run is set up.
    on_served = None if options.quiet else lambda url: print_result(f"{DASHBOARD_READY}{url}")
    session = open_lockstep_session("tcp/127.0.0.1:0")
    try:
        words = ["dashboard", "--connect", listening_at(session)[0], "--team", DEFAULT_TEAM]
        port = [] if options.port is None else ["--port", str(options.port)]
        return Watched(session, StartingPage(children, [*words, *port], on_served))
    except BaseException:
        session.close()
        raise
