"""The roster: which robots there are, and what they last said."""

from robrain.protocol.wire.clock import to_ns, to_seconds
from robrain.protocol.wire.messages import RobotState, RobotSummary
from robrain.protocol.wire.presence import Change

LOST_AFTER_S = 1.0
"""A robot that has said nothing for this long is not counted on, whatever its token says."""
_LOST_AFTER_NS = to_ns(LOST_AFTER_S)


class Robot:
    """One robot of the team."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.state: RobotState | None = None
        self.heard_ns: int | None = None
        self.has_token = False

    def age_s(self, now_ns: int) -> float:
        """Time since its last state; infinite before the first."""
        return float("inf") if self.heard_ns is None else to_seconds(now_ns - self.heard_ns)

    def is_up(self, now_ns: int) -> bool:
        """Whether it can be counted on."""
        return self.has_token and self.age_s(now_ns) <= LOST_AFTER_S

    def why_not_up(self, now_ns: int) -> str:
        """In words; empty if it is up."""
        if self.is_up(now_ns):
            return ""
        if self.heard_ns is None:
            return "nothing heard yet"
        return f"lost contact {self.age_s(now_ns):.1f} s ago" if self.has_token else "gone"


class Roster:
    """All robots ever heard of, by name."""

    def __init__(self) -> None:
        self.robots: dict[str, Robot] = {}
        self._by_name: list[Robot] = []
        self._up: list[Robot] = []
        self._up_at_ns: int | None = None
        """For when that was worked out; it is asked for several times a step, and there may be a thousand robots."""

    def note_state(self, state: RobotState, now_ns: int) -> None:
        """A robot said how it is."""
        robot = self._robot(state.robot)
        robot.state = state
        robot.heard_ns = now_ns
        self._up_at_ns = None

    def note_presence(self, change: Change) -> Robot:
        """A robot's token came or went."""
        robot = self._robot(change.names["robot"])
        robot.has_token = change.present
        self._up_at_ns = None
        return robot

    def up(self, now_ns: int) -> list[Robot]:
        """The robots that can be counted on, by name; not to be changed."""
        if self._up_at_ns != now_ns:
            since_ns = now_ns - _LOST_AFTER_NS
            self._up = [
                robot
                for robot in self._by_name
                if robot.has_token and robot.heard_ns is not None and robot.heard_ns >= since_ns
            ]
            self._up_at_ns = now_ns
        return self._up

    def summaries(self, now_ns: int) -> list[RobotSummary]:
        """Each robot in a line, by name."""
        summaries = []
        for robot in self._by_name:
            state = robot.state
            summaries.append(
                RobotSummary(
                    name=robot.name,
                    up=robot.is_up(now_ns),
                    age_s=round(min(robot.age_s(now_ns), 1e6), 3),
                    halted=state is not None and state.halted,
                    soc=state.battery.soc if state is not None and state.battery is not None else None,
                    behavior=state.behavior if state is not None else "",
                    task=state.task.id if state is not None and state.task and not state.task.state.ended else "",
                    why=robot.why_not_up(now_ns),
                    faulted=state.faulted if state is not None else [],
                )
            )
        return summaries

    def _robot(self, name: str) -> Robot:
        if name not in self.robots:
            self.robots[name] = Robot(name)
            self._by_name = [self.robots[known] for known in sorted(self.robots)]
        return self.robots[name]
