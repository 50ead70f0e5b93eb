"""A recording in place of a team: the same view, at a position in time that can be moved.

A player gives the state at a moment, but not the history that led to it: trails, charts, tasks, log, and marks. The
recording is read once for that.
"""

from bisect import bisect_right
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from robrain.dashboard.state.shown_robot import TRAIL_POINTS
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.border.border import Received
from robrain.protocol.clock import to_seconds
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT, ROBOT_LOG, LogRecord
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE, RobotState
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT, TaskEvent
from robrain.protocol.messages.team.arena_messages import ARENA_TRUTH
from robrain.protocol.messages.team.team_messages import HALT, Halt
from robrain.protocol.model.tasks.task import TaskState
from robrain.recording.reader.recorded_message import RecordedMessage, received, topic_named_by

MARKS = 400
SUMMED = {topic.name for topic in (TASK_EVENT, ROBOT_LOG, ROBOT_EVENT, HALT)}
"""Topics of which every message counts, not only the last."""
INDEXED = {*SUMMED, ROBOT_STATE.name, ARENA_TRUTH.name}


class Mark(NamedTuple):
    """A mark on the timeline."""

    time_s: float
    kind: str
    """halt, fault or task."""
    text: str
    """From the wire: not escaped."""


class ReplayIndex:
    """Reads a recording once, and fills views that begin in the middle of it."""

    def __init__(self, start_ns: int) -> None:
        self.marks: list[Mark] = []
        self._start_ns = start_ns
        self._times_s: list[float] = []
        self._summed: list[Received] = []
        self._all = ShownTeam()
        self._trails: dict[str, list[tuple[float, Any]]] = {}
        self._samples: dict[str, list[tuple[float, Any]]] = {}
        self._lost: set[str] = set()

    def handle(self, recorded: RecordedMessage) -> None:
        """The next message of the recording."""
        topic = topic_named_by(recorded.topic_key)
        if topic is None or topic.name not in INDEXED:
            return
        known = received(recorded)
        if known is None:
            return
        time_s = to_seconds(recorded.log_time_ns - self._start_ns)
        self._mark(known, time_s)
        if topic.name in SUMMED:
            self._times_s.append(time_s)
            self._summed.append(known)
            return
        self._all.apply(known, time_s)
        if topic is ROBOT_STATE:
            self._keep(known.names["robot"], time_s)

    @property
    def robots(self) -> list[str]:
        """Names of the robots in the recording."""
        return list(self._all.robots)

    def apply_events(self, view: ShownTeam, time_s: float) -> None:
        """Apply to a new view all events up to a time."""
        view.robot_numbers = {name: robot.index for name, robot in self._all.robots.items()}
        for known in self._summed[: bisect_right(self._times_s, time_s)]:
            view.apply(known, 0.0)

    def apply_history(self, view: ShownTeam, time_s: float) -> None:
        """Add the history up to a time, trails and charts, to a view of the state at that time."""
        for name, robot in view.robots.items():
            places = self._trails.get(name, [])
            robot.trail.clear()
            robot.trail.extend(place for _, place in _until(places, time_s)[-TRAIL_POINTS:])
            known = self._all.robots.get(name)
            if known is not None:
                samples = [sample for _, sample in _until(self._samples.get(name, []), time_s)]
                robot.history.continue_from(samples, known.history)
        view.explored[:] = [(at_s, share) for at_s, share in self._all.explored if at_s <= (view.sim_time_s or 0.0)]

    def _keep(self, name: str, time_s: float) -> None:
        robot = self._all.robots.get(name)
        if robot is None:
            return
        trail, samples = self._trails.setdefault(name, []), self._samples.setdefault(name, [])
        if robot.trail and (not trail or trail[-1][1] is not robot.trail[-1]):
            trail.append((time_s, robot.trail[-1]))
        if robot.history.samples and (not samples or samples[-1][1] is not robot.history.samples[-1]):
            samples.append((time_s, robot.history.samples[-1]))

    def _mark(self, received: Received, time_s: float) -> None:
        message = received.message
        if isinstance(message, Halt):
            self._add(time_s, "halt", f"{'halt' if message.halted else 'resume'} by {message.by}")
        elif isinstance(message, LogRecord) and message.level == "error":
            self._add(time_s, "fault", f"{message.robot}: {message.source} {message.text}")
        elif isinstance(message, TaskEvent) and message.state.ended and message.task.kind != "explore":
            kind = "task" if message.state is TaskState.DONE else "fault"
            self._add(time_s, kind, f"{message.task.id} {message.state.value}")
        elif isinstance(message, RobotState):
            name = received.names["robot"]
            if bool(message.lost) != (name in self._lost):
                self._lost ^= {name}
                self._add(
                    time_s, "fault", f"{name} is lost: {message.lost}" if message.lost else f"{name} is no longer lost"
                )

    def _add(self, time_s: float, kind: str, text: str) -> None:
        if len(self.marks) < MARKS:
            self.marks.append(Mark(time_s, kind, text))


def _until(entries: list[tuple[float, Any]], time_s: float) -> list[tuple[float, Any]]:
    return entries[: bisect_right(entries, time_s, key=lambda entry: entry[0])]


SPEEDS = (0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 60.0)


class ReplaySource:
    """Updates a ShownTeam from a recording; its user closes it.

    Args:
        path: an MCAP file.
        speed: of playing, recorded seconds per second.
        start_s: initial position, seconds since the first message.

    Raises:
        RecordingError: the file is no recording, or is damaged.

    """

    def __init__(self, path: Path, *, speed: float = 1.0, start_s: float = 0.0) -> None:
        # Here: it loads kernels, for which the page of a live team does not wait.
        from robrain.recording.replay.player import Player

        self.path = path
        self.player = Player(path)
        self._index = ReplayIndex(self.player.start_ns)
        self.player.prepare(self._index.handle)
        self.view = ShownTeam()
        self._runs = 0
        self._asked: deque[Callable[[float], None]] = deque(maxlen=64)
        """Requested moves, each called with the time of the next step."""
        self._received_s: float | None = None
        self._messages = 0
        self.player.set_speed(speed)
        self.seek(start_s)

    @property
    def marks(self) -> list[Mark]:
        """The marks of the timeline, by time."""
        return self._index.marks

    @property
    def robots(self) -> list[str]:
        """Names of the robots in the recording."""
        return self._index.robots

    def receive(self, now_s: float) -> None:
        """Process due messages."""
        while self._asked:
            self._asked.popleft()(now_s)
        self._age(now_s)
        if self.player.playing:
            self._handle(self.player.step(round(now_s * 1e9)), now_s)
            if self.player.done:
                self.player.pause()
        self.view.count_messages(self._messages, now_s)
        self.view.coordinator_up = self.view.team is not None

    def close(self) -> None:
        """Close the file."""
        self.player.close()

    # The next four methods may be called from any thread.

    def seek(self, time_s: float) -> None:
        """Go to a time, seconds since the first message."""
        self._asked.append(lambda now_s: self._go_to(time_s, now_s))

    def skip(self, by_s: float) -> None:
        """Go forward, or back if negative, seconds."""
        self._asked.append(lambda now_s: self._go_to(self.player.position_s + by_s, now_s))

    def toggle(self) -> None:
        """Play, or pause; at the end, play from the beginning."""
        self._asked.append(self._toggle)

    def set_speed(self, speed: float) -> None:
        """Set the speed, recorded seconds per second."""
        self._asked.append(lambda _: self.player.set_speed(speed))

    def _toggle(self, now_s: float) -> None:
        if self.player.playing:
            self.player.pause()
            return
        if self.player.done:
            self._go_to(0.0, now_s)
        self.player.play()

    def _go_to(self, time_s: float, now_s: float) -> None:
        time_s = min(max(time_s, 0.0), self.player.duration_s)
        selected = self.view.selected
        self._runs += 1
        view = self.view = ShownTeam()
        # The scene recognises another run by this number.
        view.runs, view.is_replay, view.selected = self._runs, True, selected
        state = self.player.seek(time_s)
        self._index.apply_events(view, self.player.position_s)
        self._handle(state, now_s)
        self._index.apply_history(view, self.player.position_s)

    def _handle(self, messages: list[RecordedMessage], now_s: float) -> None:
        self._messages += len(messages)
        for recorded in messages:
            known = received(recorded)
            if known is not None:
                self.view.apply(known, now_s)

    def _age(self, now_s: float) -> None:
        """Age robots by the recorded time, which stands still in a pause."""
        before, self._received_s = self._received_s, now_s
        if before is None:
            return
        pace = self.player.speed if self.player.playing else 0.0
        for robot in self.view.robots.values():
            if robot.last_seen_s is not None:
                robot.last_seen_s += (1.0 - pace) * (now_s - before)
