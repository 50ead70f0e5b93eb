"""The history of a recording up to any moment of it: trails, charts, tasks, log, and marks.

A player gives the state at a moment, but not the history that led to it. The recording is read once for that.
"""

from bisect import bisect_right
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, NamedTuple

from robrain.dashboard.state.shown_robot import TRAIL_POINTS, RobotHealth
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.border.border import Received
from robrain.protocol.clock import to_seconds
from robrain.protocol.codec import BadPayload
from robrain.protocol.messages.robots.plugin_messages import LogRecord
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.team.team_messages import Halt
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.table import topics
from robrain.protocol.table.topic import Topic

if TYPE_CHECKING:  # loads the reader of recordings
    from robrain.recording.reader.reading import RecordedMessage

MARKS = 400
SUMMED = (topics.TASK_EVENT, topics.TASK_DECISION, topics.ROBOT_LOG, topics.ROBOT_EVENT, topics.HALT)
"""Topics of which every message counts, not only the last."""


class Mark(NamedTuple):
    """A mark on the timeline."""

    time_s: float
    kind: str
    """halt, fault or task."""
    said: str
    """From the wire: not escaped."""


class MessageDecoder:
    """Decodes recorded messages; messages of unknown topics and messages that do not decode are skipped."""

    def __init__(self) -> None:
        self._topics: dict[str, tuple[Topic[Any], dict[str, str]] | None] = {}

    def decode(self, recorded: "RecordedMessage") -> Received | None:
        """One message."""
        key = recorded.topic_key
        if key not in self._topics:
            self._topics[key] = topics.topic_of(key)
        found = self._topics[key]
        if found is None or found[0].message is None:
            return None
        topic, names = found
        try:
            return Received(topic, key, names, topic.payloads.read(recorded.payload))
        except BadPayload:
            return None


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
        self._conditions: dict[str, RobotHealth] = {}

    def read(
        self, messages: "Iterable[RecordedMessage]", decode: "Callable[[RecordedMessage], Received | None]"
    ) -> None:
        """Read all messages of a recording, in order."""
        for recorded in messages:
            found = topics.topic_of(recorded.topic_key)
            topic = found[0] if found is not None else None
            if topic not in (*SUMMED, topics.ROBOT_STATE, topics.ARENA_TRUTH):
                continue
            received = decode(recorded)
            if received is None:
                continue
            time_s = to_seconds(recorded.log_time_ns - self._start_ns)
            if topic in SUMMED:
                self._times_s.append(time_s)
                self._summed.append(received)
            self._mark(received, time_s)
            if topic in (topics.ROBOT_STATE, topics.ARENA_TRUTH):
                self._all.apply(received, time_s)
                if topic is topics.ROBOT_STATE:
                    self._keep(received.names["robot"], time_s)

    @property
    def robots(self) -> list[str]:
        """Names of the robots in the recording."""
        return list(self._all.robots)

    def apply_events(self, view: ShownTeam, time_s: float) -> None:
        """Apply to a new view all events up to a time."""
        view.check_order = {name: robot.index for name, robot in self._all.robots.items()}
        for received in self._summed[: bisect_right(self._times_s, time_s)]:
            view.apply(received, 0.0)

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
            message_text = "halt" if message.halted else "resume"
            self._add(time_s, "halt", f"{message_text} by {message.by}")
        elif isinstance(message, LogRecord) and message.level == "error":
            self._add(time_s, "fault", f"{message.robot}: {message.source} {message.text}")
        elif isinstance(message, TaskEvent) and message.state.ended and message.task.kind != "explore":
            kind = "task" if message.state is TaskState.DONE else "fault"
            self._add(time_s, kind, f"{message.task.id} {message.state.value}")
        elif isinstance(message, RobotState):
            name = received.names["robot"]
            lost = RobotHealth.ASTRAY if message.lost else RobotHealth.UP
            if self._conditions.get(name, RobotHealth.UP) is not lost:
                self._conditions[name] = lost
                message_text = f"is lost: {message.lost}" if message.lost else "is no longer lost"
                self._add(time_s, "fault", f"{name} {message_text}")

    def _add(self, time_s: float, kind: str, message_text: str) -> None:
        if len(self.marks) < MARKS:
            self.marks.append(Mark(time_s, kind, message_text))


def _until(entries: list[tuple[float, Any]], time_s: float) -> list[tuple[float, Any]]:
    return entries[: bisect_right(entries, time_s, key=lambda entry: entry[0])]
