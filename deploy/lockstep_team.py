"""A simulated team in this process, tick by tick: what scripts and notebooks talk to.

from robrain import LockstepTeam, Point2D, Scenario, Visit

with LockstepTeam(Scenario.builtin("depot").replace(robots=2)) as team:
    team.submit(Visit(id="look-1", place=Point2D(3.0, 8.0)))
    print(team.wait("look-1")[0].result)

Time passes only in `run_for` and `wait`; equal seeds and equal calls give equal runs. `TaskClient` asks a live team the
same questions by the same names.
"""

from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self, TypeVar

import msgspec

from robrain.coordinator.recording.recorder import RecordingSummary
from robrain.protocol.model.task import Task
from robrain.protocol.model.warm_up import warm_up
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.errors import NobodyThere
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.keys import DEFAULT_TEAM
from robrain.protocol.wire.messages import HostRequest, MoteReading, PluginInfo, RobotState, TeamState
from robrain.protocol.wire.task_messages import TaskFilter, TaskRecord, TaskRequest, TaskSubmission, TaskWhy
from robrain.protocol.wire.topics import (
    COORDINATOR_STATE,
    MOTE_READING,
    ROBOT_CALL,
    ROBOT_HOST,
    ROBOT_STATE,
    TASK_CANCEL,
    TASK_GET,
    TASK_LIST,
    TASK_SUBMIT,
    TASK_WHY,
)
from robrain.sim.lockstep import LockstepRun
from robrain.sim.scenario import Scenario

T = TypeVar("T")
# `list` is also what the team is asked for its tasks by.
Names = list[str]
PluginInfos = list[PluginInfo]
TaskRecords = list[TaskRecord]

BY = "script"
LOOK_TICKS = 10
"""How often a condition is looked at."""
KEPT_READINGS = 10_000


class LockstepTeam:
    """A team in lockstep; use it in a `with` block.

    Args:
        scenario: what is simulated.
        record: MCAP file to write, or None.

    Raises:
        RobrainError: saying what cannot be simulated or opened.

    """

    def __init__(self, scenario: Scenario, *, record: Path | str | None = None) -> None:
        world = scenario.world()
        warm_up()
        path = Path(record) if record is not None else None
        self.lockstep = LockstepRun(
            world, record=path, scenario=scenario.name, scenario_toml=scenario.toml, planning=scenario.planning
        )
        """The run itself: arena, hosts and coordinator are in it, for whoever wants to look inside."""
        self.summary: RecordingSummary | None = None
        """Digest and recording, once the team is closed."""
        self.readings: deque[MoteReading] = deque(maxlen=KEPT_READINGS)
        """What the motes have told, the last of it, in order of arrival."""
        self._states: dict[str, RobotState] = {}
        self._team = TeamState(robots=[])
        self._inbox = Inbox()
        self._wire = Endpoint(self.lockstep.session, DEFAULT_TEAM, self.lockstep.clock, Drive.LOCKSTEP)
        for topic in (ROBOT_STATE, COORDINATOR_STATE, MOTE_READING):
            self._wire.subscribe(self._inbox, topic)

    # -- time -----------------------------------------------------------------------------------------------

    @property
    def now_s(self) -> float:
        """Simulated time so far."""
        return self.lockstep.sim_time_s

    def run_for(self, seconds: float, until: Callable[[], bool] | None = None) -> bool:
        """Let simulated time pass.

        Args:
            seconds: so much at the most.
            until: looked at five times a simulated second; time stands still as soon as it holds.

        Returns:
            Whether `until` held in time; True without one.

        """
        ends_s, ticks = self.now_s + seconds, 0
        while self.now_s < ends_s - 1e-9:
            self.lockstep.tick()
            ticks += 1
            if ticks % LOOK_TICKS == 0:
                self._hear()
                if until is not None and until():
                    return True
        return until is None or until()

    def wait(self, *task_ids: str, timeout_s: float = 600.0) -> TaskRecords:
        """Let time pass until tasks have ended (TimeoutError if they have not in so many simulated seconds)."""
        if not self.run_for(timeout_s, lambda: all(self.get(task_id).state.ended for task_id in task_ids)):
            late = ", ".join(task_id for task_id in task_ids if not self.get(task_id).state.ended)
            raise TimeoutError(f"not ended after {timeout_s:g} simulated seconds: {late}")
        return [self.get(task_id) for task_id in task_ids]

    # -- tasks ----------------------------------------------------------------------------------------------

    def submit(
        self, task: Task, *, earliest_in_s: float | None = None, deadline_in_s: float | None = None
    ) -> TaskRecord:
        """Have a task done (CallError with the reason if it is refused); see `TaskClient.submit`."""
        asked = TaskSubmission(task=task, by=BY, earliest_in_s=earliest_in_s, deadline_in_s=deadline_in_s)
        return self._wire.ask(TASK_SUBMIT, asked)

    def cancel(self, task_id: str, why: str = "") -> TaskRecord:
        """End a task unfinished."""
        return self._wire.ask(TASK_CANCEL, TaskRequest(id=task_id, by=BY, why=why))

    def get(self, task_id: str) -> TaskRecord:
        """How a task stands (CallError if there is none of that id)."""
        return self._wire.ask(TASK_GET, TaskRequest(id=task_id))

    def why(self, task_id: str) -> TaskWhy:
        """Why a task stands as it does, and how each robot stood to it."""
        return self._wire.ask(TASK_WHY, TaskRequest(id=task_id))

    def list(self, wanted: TaskFilter | None = None) -> TaskRecords:
        """The tasks that match, in the order in which they were accepted."""
        return self._wire.ask(TASK_LIST, wanted or TaskFilter())

    # -- robots ---------------------------------------------------------------------------------------------

    @property
    def robots(self) -> Names:
        """Their names."""
        return [host.name for host in self.lockstep.hosts]

    def state(self, robot: str) -> RobotState:
        """What a robot last said of itself (NobodyThere if it has said nothing yet)."""
        self._hear()
        if robot not in self._states:
            raise NobodyThere(f"{robot} has said nothing yet: let some time pass; there are {', '.join(self.robots)}")
        return self._states[robot]

    @property
    def team(self) -> TeamState:
        """The coordinator's last summary."""
        self._hear()
        return self._team

    def call(self, robot: str, plugin: str, function: str, *arguments: object) -> Any:
        """Call an external function of a robot's plugin; its result (CallError if it is refused or fails)."""
        return msgspec.json.decode(
            self._wire.ask(ROBOT_CALL, msgspec.json.encode(arguments), robot=robot, plugin=plugin, function=function)
        )

    def load(self, robot: str, place: Path | str) -> PluginInfos:
        """Load the plugins of a folder, or of one manifest, into a robot that is running (CallError if it cannot)."""
        path = Path(place).resolve()
        for host in self.lockstep.hosts:
            if host.name == robot:
                host.open_folder(path)  # the author of the script may load any path it names
        asked = HostRequest(plugin=str(path), by=BY)
        reply = self._wire.ask(ROBOT_HOST, asked, robot=robot, verb="load")
        return msgspec.json.decode(reply, type=PluginInfos)

    # -- the end --------------------------------------------------------------------------------------------

    def close(self) -> RecordingSummary | None:
        """Stop everything; digest and recording."""
        if self.summary is None:
            self._hear()
            self._wire.close()
            self.summary = self.lockstep.close()
        return self.summary

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _hear(self) -> None:
        for received in self._inbox.drain():
            message = received.message
            if isinstance(message, RobotState):
                self._states[message.robot] = message
            elif isinstance(message, TeamState):
                self._team = message
            else:
                self.readings.append(message)
