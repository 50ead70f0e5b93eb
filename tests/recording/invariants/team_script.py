"""A run as a script, for the judges of invariants."""

from typing import Any

from msgspec import UNSET, UnsetType

from robrain.protocol.clock import to_ns
from robrain.protocol.messages.robots.robot_messages import BatteryState, RobotState, TaskStatus
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.team.arena_messages import ArenaTruth, RobotTruth
from robrain.protocol.messages.team.team_messages import Halt, HaltStatus, RobotSummary, TeamState
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.recording.invariants.invariant import UNKNOWN_SURROUNDINGS, Invariant, Ruling, Surroundings
from robrain.recording.invariants.judging import Judging

RADIUS_M = 0.2


class TeamScript:
    """Messages of a team by their time; `now_s` is moved by hand or by `pass_time`."""

    def __init__(self) -> None:
        self.messages: list[tuple[Any, int]] = []
        self.now_s = 0.0
        self.change = 0
        self.states: dict[str, dict[str, Any]] = {}
        """State of each robot, as it reports it."""
        self.truths: dict[str, dict[str, Any]] = {}
        """True state of each robot."""
        self.tasks_open = 0
        self.halt: HaltStatus | None = None
        self.up: dict[str, bool] = {}
        self.has_coordinator = True
        self.unwritable: str | UnsetType = UNSET
        """Reason why the coordinator cannot write its journal."""

    def send(self, message: Any) -> None:
        """A message, now."""
        self.messages.append((message, to_ns(self.now_s)))

    def event(self, task: str, state: TaskState, robot: str = "", epoch: int = 0, change: int | None = None) -> None:
        """A change of a task, with the next number unless another is given."""
        if change is None:
            self.change += 1
            change = self.change
        subject = Task(id=task, kind="visit", place=Point2D(0.0, 0.0))
        stamp_ns = to_ns(self.now_s)
        self.send(TaskEvent(task=subject, state=state, robot=robot, epoch=epoch, change=change, stamp_ns=stamp_ns))

    def pass_time(self, seconds: float, every_s: float = 0.1) -> None:
        """Robots, arena and coordinator publish, each at its rate."""
        steps = round(seconds / every_s)
        for step in range(steps):
            self.now_s = round(self.now_s + every_s, 6)
            for robot, state in self.states.items():
                self.send(RobotState(robot=robot, radius_m=RADIUS_M, **state))
            if step % 2 == 0 and self.truths:
                self.send(truth(self.now_s, **self.truths))
            if step % 5 == 0 and self.has_coordinator:
                names = sorted(self.up or dict.fromkeys(self.states, True))
                robots = [RobotSummary(name=name, up=self.up.get(name, True), age_s=0.1) for name in names]
                self.send(
                    TeamState(robots=robots, tasks_open=self.tasks_open, halt=self.halt, unwritable=self.unwritable)
                )

    def halt_team(self, by: str = "ann") -> None:
        """A client halts the team, and the coordinator receives it."""
        stamp_ns = to_ns(self.now_s)
        self.send(Halt(halted=True, by=by, stamp_ns=stamp_ns))
        self.halt = HaltStatus(halted=True, by=[by], since_ns=stamp_ns, stamp_ns=stamp_ns)

    def resume_team(self, by: str = "ann") -> None:
        """The end of it."""
        self.send(Halt(halted=False, by=by, stamp_ns=to_ns(self.now_s)))
        self.halt = HaltStatus(halted=False, by=[by])

    def ruling(self, invariant: Invariant, surroundings: Surroundings = UNKNOWN_SURROUNDINGS) -> Ruling:
        """The verdict on an invariant after all messages."""
        judging = Judging(surroundings)
        for message, time_ns in self.messages:
            judging.handle(message, time_ns)
        return next(ruling for ruling in judging.finish() if ruling.invariant is invariant)

    def found(self, invariant: Invariant, surroundings: Surroundings = UNKNOWN_SURROUNDINGS) -> list[dict[str, Any]]:
        """The findings that break an invariant."""
        return [breach.finding for breach in self.ruling(invariant, surroundings).breaches]

    def codes(self, invariant: Invariant, surroundings: Surroundings = UNKNOWN_SURROUNDINGS) -> list[str]:
        """The codes of these findings."""
        return [finding["code"] for finding in self.found(invariant, surroundings)]


def truth(now_s: float, **robots: dict[str, Any]) -> ArenaTruth:
    """The true state of the robots."""
    found = []
    for name, values in robots.items():
        x_m, y_m = values.get("at", (1.0, 1.0))
        found.append(
            RobotTruth(
                robot=name,
                pose=Pose2D(x_m, y_m, 0.0),
                collisions=values.get("collisions", 0),
                distance_m=values.get("distance_m", 0.0),
                energy_j=values.get("energy_j", 0.0),
            )
        )
    return ArenaTruth(sim_time_s=now_s, robots=found)


def at_task(task: str, epoch: int = 1, state: TaskState = TaskState.RUNNING) -> dict[str, Any]:
    """State of a robot that does a task."""
    return {"task": TaskStatus(id=task, epoch=epoch, state=state)}


def battery(soc: float, *, charging: bool = False, full_j: float = 10_000.0, half_j: float = 200.0) -> dict[str, Any]:
    """State of a battery, with an interval of `half_j` to both sides."""
    left_j = soc * full_j
    return {
        "battery": BatteryState(
            voltage_v=15.0,
            current_a=-1.0 if charging else 1.0,
            temperature_c=22.0,
            soc=soc,
            remaining_j=left_j,
            remaining_low_j=max(0.0, left_j - half_j),
            remaining_high_j=left_j + half_j,
            charging=charging,
        )
    }
