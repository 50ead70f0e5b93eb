"""Faults and recoveries of a run: what went wrong, when, and when it was well again."""

from typing import Any

import msgspec

from robrain.protocol.wire.messages.robots.plugin_messages import LogRecord
from robrain.protocol.wire.messages.robots.robot_messages import RobotState
from robrain.protocol.wire.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.wire.messages.team.team_messages import Halt

SILENT_S = 3.0
"""A robot that says nothing for longer than this is silent; its state comes ten times a second."""
HAPPENINGS_MAX = 5000
BAD_LEVELS = ("error", "critical")


class Happening(msgspec.Struct, kw_only=True):
    """Something that went wrong. All texts are of the wire: not escaped."""

    kind: str
    """halted, faulted, astray, silent, distrusted, task, log or team halt."""
    subject: str
    text: str
    start_s: float
    end_s: float | None = None
    """When it was well again; None if it was not, or for what has no duration."""
    lasts: bool = True
    """Whether it has a duration."""


class Happenings:
    """Follows the messages of a run, in order."""

    def __init__(self) -> None:
        self._all: list[Happening] = []
        self._open: dict[tuple[str, str], Happening] = {}
        self._heard_s: dict[str, float] = {}

    def take(self, message: Any, t_s: float) -> None:
        """The next message; most are of no interest."""
        if isinstance(message, RobotState):
            self._take_state(message, t_s)
        elif isinstance(message, TaskEvent):
            if message.state in ("failed", "lost_contact"):
                words = message.state.replace("_", " ") + (f": {message.why}" if message.why else "")
                self._point("task", message.task.id, words, t_s)
        elif isinstance(message, Halt):
            reason = f"by {message.by}" + (f": {message.reason}" if message.reason else "")
            self._follow("team halt", "team", "", reason if message.halted else "", t_s)
        elif isinstance(message, LogRecord) and message.level.lower() in BAD_LEVELS:
            self._point("log", f"{message.robot} {message.source}", message.text, t_s)

    def finish(self, end_s: float) -> list[Happening]:
        """All of them, by their beginnings; robots that said nothing until the end included."""
        for robot, heard_s in self._heard_s.items():
            if end_s - heard_s > SILENT_S:
                self._begin("silent", robot, "", "said nothing until the end", heard_s)
        return sorted(self._all, key=lambda happening: happening.start_s)

    def _take_state(self, state: RobotState, t_s: float) -> None:
        name = state.robot
        heard_s = self._heard_s.get(name, t_s)
        self._heard_s[name] = t_s
        if t_s - heard_s > SILENT_S:
            silent = Happening(kind="silent", subject=name, text="said nothing", start_s=heard_s, end_s=t_s)
            self._add(silent)
        self._follow("halted", name, "", f"by {', '.join(state.halted_by)}" if state.halted else "", t_s)
        self._follow("astray", name, "", state.lost, t_s)
        distrusted = state.battery.implausible if state.battery is not None else ""
        self._follow("distrusted", name, "", distrusted, t_s)
        faulted = {fault.plugin: fault.why or "does not run" for fault in state.faulted}
        for kind, key in [key for key in self._open if key[0] == "faulted" and key[1].startswith(f"{name}/")]:
            if key.partition("/")[2] not in faulted:
                self._open.pop((kind, key)).end_s = t_s
        for plugin, why in faulted.items():
            self._follow("faulted", name, plugin, why, t_s)

    def _follow(self, kind: str, subject: str, part: str, text: str, t_s: float) -> None:
        """A state that begins with a text, and ends when it is empty."""
        happening = self._open.get((kind, f"{subject}/{part}"))
        if text and happening is None:
            self._begin(kind, subject, part, text, t_s)
        elif not text and happening is not None:
            del self._open[kind, f"{subject}/{part}"]
            happening.end_s = t_s

    def _begin(self, kind: str, subject: str, part: str, text: str, t_s: float) -> None:
        words = f"{part}: {text}" if part else text
        happening = Happening(kind=kind, subject=subject, text=words, start_s=t_s)
        self._open[kind, f"{subject}/{part}"] = happening
        self._add(happening)

    def _point(self, kind: str, subject: str, text: str, t_s: float) -> None:
        self._add(Happening(kind=kind, subject=subject, text=text, start_s=t_s, lasts=False))

    def _add(self, happening: Happening) -> None:
        if len(self._all) < HAPPENINGS_MAX:
            self._all.append(happening)
