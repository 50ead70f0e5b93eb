"""The table of a team's processes, for `robrain up` and `robrain top`."""

import socket
import time
from collections.abc import Sequence
from contextlib import nullcontext

from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from robrain.deploy.command_line.output import print_either
from robrain.deploy.command_line.terminal import console, new_table, results
from robrain.deploy.processes.live_process import LiveStop, client_endpoint
from robrain.deploy.supervision.part import (
    ARENA,
    COORDINATOR,
    DASHBOARD,
    HUB,
    RECORDER,
    UNKNOWN_FIGURES,
    MemberStatus,
    Phase,
    ProcessFigures,
    commands_beside,
)
from robrain.deploy.supervision.team_status import TeamMonitor
from robrain.protocol.answers.later import Later
from robrain.protocol.clock import steps
from robrain.protocol.errors import CallError, NobodyThere
from robrain.protocol.messages.robots.plugin_messages import ROBOT_WHO, ProcessInfo
from robrain.protocol.messages.team.team_messages import COORDINATOR_WHO
from robrain.protocol.safe_text import safe_text
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.hub import team_endpoints, wrong_team

COLOURS = {Phase.UP: "green", Phase.GIVEN_UP: "red", Phase.KILLED: "red"}
UNKNOWN = "–"
PERIOD_S = 0.1
ASK_AGAIN_S = 2.0
"""Between two questions to a member which process it is."""
ASK_TIMEOUT_S = 2.0
STARTED_AS = {"hub": HUB, "router": HUB, "arena": ARENA, "record": RECORDER, "dashboard": DASHBOARD}
"""Commands of the parts that do not report which process they are, with the names of these parts."""
ONCE_S = 2.5
"""Time to receive a team's messages before its table is printed once."""


def members_table(parts: Sequence[MemberStatus]) -> Table:
    """One row for each process; unknown figures are dashes, and texts from elsewhere made safe for a terminal."""
    numbers = ("process", "CPU", "memory", "messages", "restarts")
    table = new_table("part", *numbers, "state", right=numbers)
    for part in parts:
        state = part.phase.value
        if part.phase is Phase.UP and part.words:
            state = f"{f'on {part.host}, ' if part.host and part.cpu_share is None else ''}{part.words}"
        table.add_row(
            safe_text(part.name),
            UNKNOWN if part.pid is None else str(part.pid),
            UNKNOWN if part.cpu_share is None else f"{part.cpu_share:.0%}",
            UNKNOWN if part.memory_mb is None else f"{part.memory_mb:.0f} MB",
            safe_text(part.messages or "") or UNKNOWN,
            UNKNOWN if part.restarts is None else str(part.restarts),
            Text(safe_text(state), COLOURS.get(part.phase, "yellow")),
        )
    return table


class Top:
    """Status of a team's processes.

    Args:
        wire: the team's endpoint.

    """

    def __init__(self, wire: Endpoint) -> None:
        self.team = TeamMonitor(wire)
        self._wire = wire
        self._host = socket.gethostname()
        self._asked: dict[str, Later[ProcessInfo]] = {}
        self._ask_s: dict[str, float] = {}
        self._known: dict[str, ProcessInfo] = {}
        self._figures: dict[int, ProcessFigures] = {}
        self._beside: dict[str, ProcessInfo] = {}
        """Parts that `robrain up` has started on this machine beside a known member."""
        self._beside_s = 0.0

    def update(self, now_s: float) -> None:
        """Process arrived messages, and query unknown members.

        Args:
            now_s: a clock that only goes forward, s.

        """
        self.team.update()
        names = self._names()
        for name in names:
            later = self._asked.get(name)
            if later is not None:
                try:
                    info = later.poll()
                except (CallError, NobodyThere):
                    del self._asked[name]
                    continue
                if info is not None:
                    del self._asked[name]
                    self._known[name] = info
            elif name not in STARTED_AS.values() and now_s >= self._ask_s.get(name, 0.0):
                self._ask_s[name] = now_s + ASK_AGAIN_S
                self._asked[name] = self._ask(name)
        for gone in set(self._ask_s) - set(names):
            del self._ask_s[gone]
            self._asked.pop(gone, None)
            self._known.pop(gone, None)
        here = next((info.pid for info in self._known.values() if info.host == self._host), None)
        if here is not None and now_s >= self._beside_s:
            self._beside_s = now_s + ASK_AGAIN_S
            self._beside = self._find_beside(here)
        pids = {info.pid for info in (*self._known.values(), *self._beside.values())}
        self._figures = {pid: figures for pid, figures in self._figures.items() if pid in pids}

    def members(self, now_s: float) -> list[MemberStatus]:
        """The members, the coordinator first."""
        words = {robot.name: robot.words for robot in self.team.robots()}
        return [self._member(name, words.get(name, "up"), now_s) for name in self._names()]

    def _names(self) -> list[str]:
        names = [COORDINATOR] if self.team.has_coordinator else []
        names += [name for name in STARTED_AS.values() if name in self._beside or self.team.messages(name)]
        return [*dict.fromkeys(names), *(robot.name for robot in self.team.robots())]

    def _find_beside(self, pid: int) -> dict[str, ProcessInfo]:
        found = {}
        for other, words in commands_beside(pid):
            command = next((word for word in words if word in STARTED_AS), "")
            if command and ("--team" not in words or self._wire.team in words):
                found[STARTED_AS[command]] = ProcessInfo(self._host, other, "")
        return found

    def _ask(self, name: str) -> Later[ProcessInfo]:
        if name == COORDINATOR:
            return self._wire.ask_later(COORDINATOR_WHO, timeout_s=ASK_TIMEOUT_S)
        return self._wire.ask_later(ROBOT_WHO, timeout_s=ASK_TIMEOUT_S, robot=name)

    def _member(self, name: str, words: str, now_s: float) -> MemberStatus:
        info = self._known.get(name) or self._beside.get(name)
        messages = self.team.messages(name) or None
        if info is None:
            return MemberStatus(name, words, messages=messages)
        figures = UNKNOWN_FIGURES
        if info.host == self._host:
            figures = self._figures.setdefault(info.pid, ProcessFigures(info.pid)).at(now_s)
        return MemberStatus(name, words, info.host, info.pid, info.version or None, *figures, messages)


def top_command(connect: str | None, team: str, *, once: bool, as_json: bool) -> None:
    """Show a team until Ctrl-C; print the table once if not at a terminal.

    Raises:
        NobodyThere: there is no answer, or no member of the team is there.

    """
    should_stop = LiveStop()
    with client_endpoint(connect, team) as wire:
        found = Top(wire)
        began_s = time.monotonic()
        prints_once = once or as_json or not console.is_terminal
        with nullcontext() if prints_once else Live(console=console, refresh_per_second=2) as live:
            for _ in steps(should_stop, PERIOD_S):
                now_s = time.monotonic()
                found.update(now_s)
                members = found.members(now_s)
                is_time = now_s - began_s > ONCE_S
                if is_time and not members:
                    raise wrong_team(f"nobody of team {team} is at {', '.join(team_endpoints(connect))}", wire)
                if prints_once and is_time:
                    break
                if live is not None:
                    live.update(Group(f"team {team}", members_table(members)))
        if prints_once and not should_stop():
            print_either(members, lambda: results().print(members_table(members)), as_json=as_json)
