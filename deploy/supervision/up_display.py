"""Displays for `robrain up`: on a terminal, line by line, or as lines of JSON."""

import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
from rich.live import Live

from robrain.deploy.commands.terminal import both_at_a_terminal, clock_of, console, print_line, say
from robrain.deploy.processes.forwarder_words import said
from robrain.deploy.processes.live_process import tell_json
from robrain.deploy.supervision.part import PartEvent
from robrain.deploy.supervision.part_table import drawn
from robrain.deploy.supervision.up import UpDisplay, UpResult, UpStatus
from robrain.protocol.wire.access.identity import TLS_VARIABLE
from robrain.protocol.wire.hub import CONNECT_VARIABLE, hub_endpoint


class HubEvent(msgspec.Struct, frozen=True, tag_field="event", tag="hub", omit_defaults=True):
    """Where the team's hub listens."""

    endpoint: str
    tls: str = ""
    """Folder of an operator's certificate, for `robrain --tls`; empty if the team is plain."""


class JournalEvent(msgspec.Struct, frozen=True, tag_field="event", tag="journal"):
    """Where the coordinator keeps its tasks."""

    path: str


class DashboardEvent(msgspec.Struct, frozen=True, tag_field="event", tag="dashboard"):
    """Where the page is served."""

    url: str


class ForwarderEvent(msgspec.Struct, frozen=True, tag_field="event", tag="serial_forwarder"):
    """Where the Serial Forwarder of a robot's base station listens."""

    robot: str
    address: str
    """`host:port`."""


class JsonEvents:
    """One event per line on stdout, as it occurs; the last is the result."""

    def __init__(self) -> None:
        self._forwarders: dict[str, str] = {}

    def hub(self, endpoint: str, taken: str, tls: Path | None = None) -> None:
        """Print where the hub listens; warn on stderr if that is not this machine's hub endpoint."""
        _warn_of_taken(endpoint, taken)
        _print(HubEvent(endpoint, "" if tls is None else str(tls)))

    def journal(self, path: Path) -> None:
        """Print where the journal is."""
        _print(JournalEvent(str(path)))

    def dashboard(self, url: str) -> None:
        """Print where the page is."""
        _print(DashboardEvent(url))

    def part(self, event: PartEvent) -> None:
        """Print what happened to a part."""
        _print(event)

    def show(self, status: UpStatus) -> None:
        """Print new forwarders."""
        for robot, address in status.forwarders.items():
            if self._forwarders.get(robot) != address:
                self._forwarders[robot] = address
                _print(ForwarderEvent(robot, address))

    def ended(self, result: UpResult) -> None:
        """Print the result."""
        _print(result)


class PlainLines:
    """Endpoints on stdout; a line on stderr for each team member that joins or leaves."""

    def __init__(self, print_text: Callable[[str], None] = print_line) -> None:
        self._before: dict[str, str] = {}
        self._print = print_text

    def hub(self, endpoint: str, taken: str, tls: Path | None = None) -> None:
        """Print where the hub listens, and how found by other commands."""
        _warn_of_taken(endpoint, taken)
        needed = {} if endpoint == hub_endpoint() else {CONNECT_VARIABLE: endpoint}
        needed |= {} if tls is None else {TLS_VARIABLE: str(tls)}
        self._print(f"hub: {endpoint}  ({'other commands find it after:' if needed else 'other commands find it'})")
        if needed:
            self._print(f"export {' '.join(f'{name}={shlex.quote(value)}' for name, value in needed.items())}")

    def journal(self, path: Path) -> None:
        """Print where the journal is."""
        self._print(f"journal: {path}")

    def dashboard(self, url: str) -> None:
        """Print where the page is."""
        self._print(f"dashboard: {url}")

    def part(self, event: PartEvent) -> None:
        """Print what happened to a part, in one line on stderr."""
        if event.is_news:
            say(event.words)

    def show(self, status: UpStatus) -> None:
        """Print what has changed."""
        now = dict(status.robots) | {"coordinator": "up" if status.coordinator_up else "starting"}
        for name, text in now.items():
            seen = "up" if text not in ("starting", "halted") and "lost" not in text and text != "gone" else text
            if self._before.get(name) != seen:
                self._before[name] = seen
                say(f"{name}: {seen}")
        self._show_forwarders(status)

    def _show_forwarders(self, status: UpStatus) -> None:
        for robot, address in status.forwarders.items():
            if self._before.get(address) != robot:
                self._before[address] = robot
                self._print(said(robot, address))

    def ended(self, result: UpResult) -> None:
        """Print the result of the run."""
        for name, count in result.restarts.items():
            again = "once" if count == 1 else f"{count} times"
            print_line(f"{name} was started again {again}{', then given up' if name in result.given_up else ''}")
        if not result.sim_time_s:
            print_line(result.ended)
            return
        from robrain.deploy.run.run_display import accuracy_lines, tell_recorded  # brings the simulator

        print_line(
            f"{result.ended}: {result.explored_fraction:.1%} explored in {clock_of(result.sim_time_s)}, "
            f"{result.collisions} collisions"
        )
        for line in accuracy_lines(result.map_accuracy, result.pose_accuracy):
            print_line(line)
        tell_recorded(result.recording)


class DrawnTable(PlainLines):
    """A live table of the team below the endpoints."""

    def __init__(self, live: Live) -> None:
        # Above the table rich would break long lines, which then could not be copied.
        super().__init__(say if both_at_a_terminal() else print_line)
        self._live = live

    def show(self, status: UpStatus) -> None:
        """Draw the team's status."""
        self._show_forwarders(status)
        heading = f"{status.explored_fraction:.1%} explored, {clock_of(status.sim_time_s)}; Ctrl-C stops the team"
        self._live.update(drawn(heading, status.parts))


@contextmanager
def up_display(*, as_json: bool) -> Iterator[UpDisplay]:
    """Choose the display of `robrain up` for the duration of the block."""
    if as_json:
        yield JsonEvents()
    elif console.is_terminal:
        with Live(console=console, refresh_per_second=5, redirect_stdout=False) as live:
            yield DrawnTable(live)
    else:
        yield PlainLines()


def _warn_of_taken(endpoint: str, taken: str) -> None:
    if taken:
        say(f"{taken} is in use: the hub of this team is at {endpoint}")


def _print(event: HubEvent | JournalEvent | DashboardEvent | ForwarderEvent | PartEvent | UpResult) -> None:
    tell_json(event)
