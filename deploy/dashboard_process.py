"""The dashboard in a process of its own, beside a run, a team or a replay."""

import threading
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import urlsplit

from robrain.deploy.children import Children
from robrain.deploy.errors import ChildFailed

READY_PREFIX = "dashboard: "
START_TIMEOUT_S = 30.0


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
    arguments = ["dashboard", "--connect", endpoint, "--team", team]
    if port is not None:
        arguments += ["--port", str(port)]
    return _start_page(children, arguments)


def go_on_with_recording(children: Children, url: str, recording: Path) -> None:
    """Have a dashboard's page show a recording of the team that has gone; browsers that look on find it by themselves.

    Args:
        children: owns the dashboard's process, and nothing else by now: it is stopped for another one.
        url: the page's address, which stays the same.
        recording: an MCAP file.

    Raises:
        ChildFailed: it did not start; the text says why.

    """
    children.stop()
    _start_page(children, ["dashboard", "--replay", str(recording), "--port", str(urlsplit(url).port)])


def _start_page(children: Children, arguments: Sequence[str]) -> str:
    """Start a dashboard and wait until its page is served; the page's address."""
    ready = threading.Event()
    url = ""

    def note(line: str) -> None:
        nonlocal url
        if line.startswith(READY_PREFIX) and not url:
            url = line.removeprefix(READY_PREFIX)
            ready.set()

    child = children.start("dashboard", arguments, note)
    waited_s = 0.0
    while not ready.wait(0.1):
        waited_s += 0.1
        if child.exit_status is not None or waited_s > START_TIMEOUT_S:
            children.stop()
            said = next((line for line in reversed(child.lines) if line.strip()), "it said nothing")
            raise ChildFailed(f"the dashboard did not start: {said.removeprefix('robrain: ')}")
    return url
