"""`robrain top`: the processes of a running team, seen from outside.

Robots and the coordinator answer which process they are. Hub, arena, recorder and dashboard are found among the
processes beside them, if all were started by one `robrain up` on this machine. CPU and memory are read from /proc; on
other machines they are unknown, as are the restarts, which only `robrain up` counts.
"""

import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import msgspec
from rich.live import Live

from robrain.deploy.command_line.terminal import console, print_line
from robrain.deploy.processes.live_process import LiveStop, client_session, live_endpoint, print_json_line
from robrain.deploy.supervision.part import ARENA, COORDINATOR, DASHBOARD, HUB, RECORDER, PartView
from robrain.deploy.supervision.part_table import drawn, lines_of
from robrain.deploy.supervision.process_figures import ProcessFigures, commands_beside
from robrain.deploy.supervision.restarts import Phase
from robrain.deploy.supervision.team_watch import TeamWatch
from robrain.protocol.answers.later import Later
from robrain.protocol.errors import CallError, NobodyThere
from robrain.protocol.messages.robots.plugin_messages import ProcessInfo
from robrain.protocol.table.topics import COORDINATOR_WHO, ROBOT_WHO
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.hub import team_endpoints, wrong_team

PERIOD_S = 0.1
ASK_AGAIN_S = 2.0
"""Between two questions to a member which process it is."""
ASK_TIMEOUT_S = 2.0
STARTED_AS = {"hub": HUB, "router": HUB, "arena": ARENA, "record": RECORDER, "dashboard": DASHBOARD}
"""Commands of the parts that do not report which process they are, with the names of these parts."""
ONCE_S = 2.5
"""Time to hear a team before its table is printed once."""


class TopMember(msgspec.Struct, frozen=True, omit_defaults=True):
    """A member of a team, as `robrain top --json` prints it. What is unknown is left out."""

    name: str
    words: str = ""
    """How it is."""
    host: str | None = None
    pid: int | None = None
    version: str | None = None
    cpu_share: float | None = None
    """Of one core."""
    memory_mb: float | None = None
    messages: str | None = None
    """Rate of its messages."""


class Top:
    """What is known of a team's processes.

    Args:
        wire: of the team.
        host: name of this machine, on which processes can be looked at.
        figures: follows a process of this machine.

    """

    def __init__(
        self,
        wire: Endpoint,
        host: str = "",
        figures: Callable[[int], ProcessFigures] = ProcessFigures,
    ) -> None:
        self.watch = TeamWatch(wire)
        self._wire = wire
        self._host = host or socket.gethostname()
        self._make_figures = figures
        self._asked: dict[str, Later[ProcessInfo]] = {}
        self._ask_s: dict[str, float] = {}
        self._known: dict[str, ProcessInfo] = {}
        self._figures: dict[int, ProcessFigures] = {}
        self._beside: dict[str, ProcessInfo] = {}
        """Parts that `robrain up` has started on this machine beside a known member."""
        self._beside_s = 0.0

    def look(self, now_s: float) -> None:
        """Take in what has arrived, and ask who is not known.

        Args:
            now_s: a clock that only goes forward, s.

        """
        self.watch.look()
        names = self._names()
        for name in names:
            later = self._asked.get(name)
            if later is not None:
                try:
                    info = later.take()
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

    def members(self, now_s: float) -> list[TopMember]:
        """The members, the coordinator first."""
        words = {robot.name: robot.words for robot in self.watch.robots()}
        return [self._member(name, words.get(name, "up"), now_s) for name in self._names()]

    def _names(self) -> list[str]:
        names = [COORDINATOR] if self.watch.has_coordinator else []
        names += [name for name in STARTED_AS.values() if name in self._beside or self.watch.messages(name)]
        return [*dict.fromkeys(names), *(robot.name for robot in self.watch.robots())]

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

    def _member(self, name: str, words: str, now_s: float) -> TopMember:
        info = self._known.get(name) or self._beside.get(name)
        messages = self.watch.messages(name) or None
        if info is None:
            return TopMember(name, words, messages=messages)
        figures = None
        if info.host == self._host:
            follow = self._figures.setdefault(info.pid, self._make_figures(info.pid))
            figures = follow.at(now_s)
        return TopMember(
            name,
            words,
            info.host,
            info.pid,
            info.version or None,
            figures.cpu_share if figures is not None else None,
            figures.memory_mb if figures is not None else None,
            messages,
        )


def top_command(connect: str | None, team: str, *, once: bool, as_json: bool) -> None:
    """Show a team until Ctrl-C; print the table once if not at a terminal.

    Raises:
        NobodyThere: nothing answers, or no member of the team is there.

    """
    should_stop = LiveStop()
    with client_session(connect) as session, live_endpoint(session, team) as wire:
        found = Top(wire)
        began_s = time.monotonic()
        prints_once = once or as_json or not console.is_terminal
        with _showing(prints_once=prints_once) as show:
            while not should_stop():
                now_s = time.monotonic()
                found.look(now_s)
                members = found.members(now_s)
                is_time = now_s - began_s > ONCE_S
                if is_time and not members:
                    raise wrong_team(f"nobody of team {team} is at {', '.join(team_endpoints(connect))}", wire)
                if prints_once and is_time:
                    break
                show(f"team {team}", members)
                time.sleep(PERIOD_S)
        if prints_once and not should_stop():
            _print(members, as_json=as_json)


@contextmanager
def _showing(*, prints_once: bool) -> Iterator[Callable[[str, list[TopMember]], None]]:
    if prints_once:
        yield lambda _heading, _members: None
        return
    with Live(console=console, refresh_per_second=2) as live:
        yield lambda heading, members: live.update(drawn(heading, [_view(member) for member in members]))


def _print(members: list[TopMember], *, as_json: bool) -> None:
    if as_json:
        print_json_line(members)
        return
    for line in lines_of([_view(member) for member in members]):
        print_line(line)


def _view(member: TopMember) -> PartView:
    where = f"on {member.host}, " if member.host is not None and member.cpu_share is None else ""
    return PartView(
        member.name,
        Phase.UP,
        member.pid,
        member.cpu_share,
        member.memory_mb,
        member.messages or "",
        None,
        f"{where}{member.words}",
    )
