"""The site of a team's parts: a folder and the team's endpoint, with the output lines of parts that others need."""

from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import msgspec

from robrain.deploy.pki.router import ROUTER_READY
from robrain.deploy.processes.children import DASHBOARD_READY, read_addresses
from robrain.deploy.processes.live_process import HUB_READY
from robrain.deploy.supervision.part import ARENA, COORDINATOR, DASHBOARD, HUB, HUB_POLICY, RECORDER, STAND_BY, Part
from robrain.deploy.supervision.team_status import TeamMonitor

RECORDER_STOP_S = 60.0
"""Time for a recorder to write waiting messages and to finish its file, on a slow disk."""


class DashboardEvent(msgspec.Struct, frozen=True, tag_field="event", tag="dashboard"):
    """Address of the page."""

    url: str


class ForwarderEvent(msgspec.Struct, frozen=True, tag_field="event", tag="serial_forwarder"):
    """Address of the Serial Forwarder of a robot's base station."""

    robot: str
    address: str
    """`host:port`."""


class _Recorded(msgspec.Struct):
    """Fields of a recorder's summary that are read."""

    messages: int


class Printed:
    """Output lines of parts that others need. Called on the threads that read their output."""

    def __init__(self, dashboard_port: int | None) -> None:
        self.endpoint = ""
        self.page = ""
        self.forwarders: dict[str, str] = {}
        self.messages = 0
        """Recorded."""
        self._dashboard_port = dashboard_port
        self._shown: list[DashboardEvent | ForwarderEvent] = []

    def dashboard_port(self) -> int | None:
        """Port of the page: once it is served it stays, so that browsers find it again."""
        return urlsplit(self.page).port if self.page else self._dashboard_port

    def events(self) -> list[DashboardEvent | ForwarderEvent]:
        """Lines that parts have printed since the last call and that the user needs."""
        found: list[DashboardEvent | ForwarderEvent] = [DashboardEvent(self.page)] if self.page else []
        found += [ForwarderEvent(robot, address) for robot, address in self.forwarders.items()]
        before, self._shown = self._shown, found
        return [event for event in found if event not in before]

    def read(self, part: str, line: str) -> None:
        """Read a line of the hub, the dashboard, the arena, or of the recorder, which ends with its summary."""
        if part == HUB:
            for prefix in (HUB_READY, ROUTER_READY):
                where = line.removeprefix(prefix).split(",")[0]
                if line.startswith(prefix) and where.startswith(("tcp/", "tls/")) and not self.endpoint:  # no warning
                    self.endpoint = where
        elif part == DASHBOARD and line.startswith(DASHBOARD_READY):
            self.page = line.removeprefix(DASHBOARD_READY)
        elif part == ARENA and (addresses := read_addresses([line])):
            self.forwarders = {**self.forwarders, **addresses}
        elif part == RECORDER and line.startswith("{"):
            with suppress(msgspec.MsgspecError):
                self.messages += msgspec.json.decode(line, type=_Recorded).messages


class Site(NamedTuple):
    """Site of the parts: this machine's folder, and the team's endpoint."""

    folder: Path
    """For files that only this run needs."""
    endpoint: str
    """Of the hub."""
    team: str
    monitor: TeamMonitor
    printed: Printed

    @property
    def common(self) -> list[str]:
        """Arguments of every part but the hub."""
        return ["--connect", self.endpoint, "--team", self.team]

    def part(self, name: str, *words: str, **settings: Any) -> Part:
        """A part with the same command line at each start."""
        return Part(name, lambda _: [*words, *self.common], **settings)

    def coordinators(
        self, journal: Path, options: Sequence[str], parts: Sequence[str], witnesses: Sequence[str]
    ) -> list[Part]:
        """The coordinator, and a stand-by coordinator with its own journal.

        Args:
            journal: file of the coordinator; the other's is `NAME-stand-by` beside it.
            options: further arguments of both.
            parts: names of the parts that run here.
            witnesses: robots that elect one of them; none if the coordinator is alone.

        """
        files = {COORDINATOR: journal, STAND_BY: journal.with_stem(f"{journal.stem}-stand-by")}
        elected = ["--witnesses", ",".join(witnesses)] if witnesses else []
        return [
            self.part(name, "coordinator", *options, *elected, "--journal", str(file))
            for name, file in files.items()
            if name in parts
        ]

    def dashboard(self) -> Part:
        """The dashboard, which keeps its page's address when it is started again."""

        def arguments(_: int) -> list[str]:
            port = self.printed.dashboard_port()
            return ["dashboard", *self.common, *([] if port is None else ["--port", str(port)])]

        return Part(DASHBOARD, arguments, must_start=True, on_line=partial(self.printed.read, DASHBOARD))

    def recorder(self, path: Path, provenance: Path | None) -> Part:
        """The recorder. A restarted recorder writes a new file: a recording is never overwritten."""
        known = [] if provenance is None else ["--provenance", str(provenance)]

        def arguments(start: int) -> list[str]:
            file = path if start == 1 else path.with_name(f"{path.stem}_again_{start}{path.suffix}")
            return ["record", "--output", str(file), "--json", *self.common, *known]

        on_line = partial(self.printed.read, RECORDER)
        return Part(RECORDER, arguments, must_start=True, stop_s=RECORDER_STOP_S, on_line=on_line)


def hub_part(listen: str, printed: Printed, *, is_secured: bool = False) -> Part:
    """The hub, or the router of a secured team; started again, it listens where it did first."""
    command = "router" if is_secured else "hub"
    return Part(
        HUB,
        lambda _: [command, "--listen", printed.endpoint or listen],
        HUB_POLICY,
        is_vital=True,
        must_start=True,
        on_line=partial(printed.read, HUB),
    )


def votes_option(journal: Path) -> list[str]:
    """Folder of the robots' votes: beside the journal of the coordinator for which they vote."""
    return ["--votes", str(journal.with_name(f"{journal.name}.votes"))]
