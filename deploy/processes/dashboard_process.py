"""The dashboard in a process of its own, beside a run, a team or a replay."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from urllib.parse import urlsplit

from robrain.deploy.errors import ChildFailed
from robrain.deploy.processes.children import Children

READY_PREFIX = "dashboard: "
START_TIMEOUT_S = 120.0
"""Limit for a process that hangs; an end is noticed at once, and imports may take long on a busy machine."""
LOOK_S = 0.05


class StartingPage:
    """A dashboard's process from its start until its page is served.

    Args:
        children: owns the process.
        arguments: the command line after `robrain`.
        on_served: called with the page's address as soon as it is served, on a thread of the child's own.

    """

    def __init__(
        self, children: Children, arguments: Sequence[str], on_served: Callable[[str], None] | None = None
    ) -> None:
        self._url = ""
        self._on_served = on_served
        self._begun_s = time.monotonic()
        self._child = children.start("dashboard", arguments, self._record)

    @property
    def url(self) -> str:
        """The page's address; empty until it is served.

        Raises:
            ChildFailed: it did not start; the text says why.

        """
        if self._url:
            return self._url
        if self._child.exit_status is not None or time.monotonic() > self._begun_s + START_TIMEOUT_S:
            self._child.ask_to_stop()
            self._child.wait()
            said = next((line for line in reversed(self._child.lines) if line.strip()), "it printed nothing")
            raise ChildFailed(f"the dashboard did not start: {said.removeprefix('robrain: ')}")
        return ""

    def _record(self, line: str) -> None:
        if line.startswith(READY_PREFIX) and not self._url:
            self._url = line.removeprefix(READY_PREFIX)
            if self._on_served is not None:
                self._on_served(self._url)


def begin_dashboard(
    children: Children, endpoint: str, team: str, port: int | None, on_served: Callable[[str], None] | None = None
) -> StartingPage:
    """Start the process; the arguments are those of `start_dashboard` and of `StartingPage`."""
    arguments = ["dashboard", "--connect", endpoint, "--team", team]
    if port is not None:
        arguments += ["--port", str(port)]
    return StartingPage(children, arguments, on_served)


def start_dashboard(children: Children, endpoint: str, team: str, port: int | None) -> str:
    """Start it and wait until its page is served.

    Args:
        children: owns the process.
        endpoint: where the team is.
        team: which team to show.
        port: to serve on; None takes 8080, or a free one if that is taken.

    Returns:
        The page's address.

    Raises:
        ChildFailed: it did not start; the text says why.

    """
    return _served(begin_dashboard(children, endpoint, team, port))


def continue_with_recording(children: Children, url: str, recording: Path) -> None:
    """Show a recording on a dashboard's page after its team has ended; open browsers reconnect by themselves.

    Args:
        children: owns the dashboard's process, and nothing else by now: it is stopped for another one.
        url: the page's address, which does not change.
        recording: an MCAP file.

    Raises:
        ChildFailed: it did not start; the text says why.

    """
    children.stop()
    page = StartingPage(children, ["dashboard", "--replay", str(recording), "--port", str(urlsplit(url).port)])
    _served(page)


def _served(page: StartingPage) -> str:
    while not (url := page.url):
        time.sleep(LOOK_S)
    return url
