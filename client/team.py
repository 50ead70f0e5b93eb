"""`Team`: a team of robots for scripts, live or simulated.

team = robrain.Team.connect("tcp/10.0.0.5:7447")       # live; without an endpoint, this machine's hub
team = robrain.Scenario.builtin("depot").team(seed=3)  # in lockstep, in this process

with team:
    task = team.submit("visit", place=(3, 4), deadline_s=120)
    team.wait(task)
    print(team.why(task).now)

Both have the same methods. Live, time passes by itself. In lockstep it passes only within methods that wait:
`wait`, `wait_all`, `run_for`, `act`, `events`, `readings`, `halt` and `resume`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Self, Unpack, overload

import msgspec

from robrain.client.fresh_ids import FreshIds
from robrain.client.halting import HaltReport, TeamOrder, order_robot
from robrain.client.members import LastStates, team_found
from robrain.client.requests import Requests
from robrain.client.robot_calls import RobotCalls
from robrain.client.submission import AS_SENT, BadTask, ChangeFields, TaskFields, TaskName, asked_task, id_of
from robrain.client.transport import PATIENCE_S, Listening, LiveTransport, Transport, operator_name
from robrain.protocol.clock import to_seconds
from robrain.protocol.errors import CallError, NobodyThere
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.maps.map_messages import COORDINATOR_LEFT_NOW, ExplorationLeft
from robrain.protocol.messages.motes.mote_messages import MOTE_READING, MoteReading
from robrain.protocol.messages.robots.plugin_messages import PluginInfo
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks import mission_messages, rule_messages
from robrain.protocol.messages.tasks.mission_messages import MissionList, MissionStart, MissionStatus
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT, TaskEvent
from robrain.protocol.messages.tasks.plan_messages import (
    COORDINATOR_OBJECTIVE,
    COORDINATOR_PLANNING,
    ObjectiveRequest,
    PlanningStatus,
)
from robrain.protocol.messages.tasks.rule_messages import RuleChange, RuleTable
from robrain.protocol.messages.tasks.task_messages import (
    TASK_CHANGE,
    TASK_DRY_RUN,
    TASK_EXPLAIN,
    TASK_GET,
    TASK_KINDS,
    TASK_LIST,
    TASK_SUBMIT,
    KnownKind,
    TaskDryRun,
    TaskExplanation,
    TaskFilter,
    TaskRecord,
    TaskRequest,
    TaskSubmission,
    TaskUpdate,
)
from robrain.protocol.messages.team.service_messages import (
    COORDINATOR_HOLD_ROBOT,
    COORDINATOR_RELEASE_ROBOT,
    COORDINATOR_RENAME_ROBOT,
    RobotRename,
    ServiceHold,
    ServiceRelease,
)
from robrain.protocol.messages.team.standing_messages import (
    COORDINATOR_LEAD,
    COORDINATOR_REMOVE_ROBOT,
    LeadRequest,
    RobotRemoval,
)
from robrain.protocol.messages.team.team_messages import HALT, Halt, TeamState
from robrain.protocol.messages.team.zone_messages import (
    COORDINATOR_ZONES_CHANGE,
    COORDINATOR_ZONES_NOW,
    ZoneChange,
    ZoneList,
    Zones,
)
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import cut
from robrain.protocol.model.rules.rule import Rule
from robrain.protocol.model.tasks.halt_latch import NAME_LENGTH, REASON_LENGTH
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.model.zone import Zone

STREAM_CHECK_S = 1.0
"""Period of the query for missed changes, in addition to the subscription."""


# The method `list` hides the built-in within the class.
Names = list[str]
PluginInfos = list[PluginInfo]
TaskRecords = list[TaskRecord]
KnownKinds = list[KnownKind]
CHECK_S = 0.2
POLL_S = 0.02
TASK_TIMEOUT_S = 600.0


class Team(RobotCalls):
    """A connection to a team; use it in a `with` block.

    While a live coordinator is away, for example during a restart, each query to it is repeated. This ends with an
    answer or after the transport's patience. This is safe, because a task with the same id is accepted only once.

    Args:
        transport: to the team; the `Team` closes it.
        by: name of the client in the records of tasks and halts, and as the holder of plugins.

    """

    def __init__(self, transport: Transport, *, by: str) -> None:
        self.transport = transport
        self.by = by
        self._listening = Listening(transport)
        self._wire = self._listening.open()
        if self._wire.member is not None:  # then the certificate names the client
            self.by = str(self._wire.member)
        self._requests = Requests(transport, self._wire)
        self._halts = self._wire.publisher(HALT)  # a halt then need not wait for its declaration
        self._last_states = LastStates(transport, self._wire)
        self._fresh_ids = FreshIds(self._known_ids, self._is_known)
        self._mission_ids = FreshIds(
            lambda name: [one.id for one in self.missions() if one.mission == name],
            lambda mission_id: any(one.id == mission_id for one in self.missions()),
        )
        self._held: set[tuple[str, str]] = set()

    @classmethod
    def connect(
        cls, endpoint: str | None = None, *, team: str = DEFAULT_TEAM, by: str = "", patience_s: float = PATIENCE_S
    ) -> Self:
        """Connect to a live team.

        Args:
            endpoint: of the team, `tcp/HOST:PORT`; None uses $ROBRAIN_CONNECT, else this machine's hub.
            team: its name.
            by: name of the client; `operator:USER` if empty.
            patience_s: how long to repeat a query that the coordinator does not answer, as during a restart.

        Raises:
            NobodyThere: nothing answers at the endpoint.
            WireError: the endpoint is invalid.
            BadName: the team's name is invalid.

        """
        return cls(LiveTransport(endpoint, team=team, patience_s=patience_s), by=by or operator_name())

    # -- time -------------------------------------------------------------------------------------------------

    @property
    def now_s(self) -> float:
        """Seconds on the team's clock: since the start of the run in lockstep, since 1970 live."""
        return to_seconds(self.transport.clock.now_ns())

    def run_for(self, seconds: float, until: Callable[[], bool] | None = None) -> bool:
        """Let time pass.

        Args:
            seconds: maximum duration.
            until: called every 0.2 s; the method returns as soon as it is true.

        Returns:
            Whether `until` became true in time; True without it.

        """
        transport = self.transport
        ends_s = transport.elapsed_s() + seconds
        while (left_s := ends_s - transport.elapsed_s()) > 1e-9:
            transport.pass_time(left_s if until is None else min(left_s, CHECK_S))
            if until is not None and until():
                return True
        return until is None or until()

    # -- tasks ------------------------------------------------------------------------------------------------

    def submit(self, task: str | Task, **fields: Unpack[TaskFields]) -> TaskRecord:
        """Submit a task; submitting the same task with the same id again returns the same answer.

        Without a coordinator, a robot of a team with consensus accepts the task and publishes it to the others.

        Fields of a task:

        - `id`: the task's name; None for a new one, such as `visit-3`.
        - `place`: x and y, metres, arena frame; or the name of a zone, for its centre.
        - `priority`: reward for doing it; the default is 1.
        - `earliest_s`: earliest start, seconds from its acceptance.
        - `deadline_s`: latest end, seconds from its acceptance.
        - `service_s`: expected time at its place.
        - `needs`: plugins that a robot must have for it; the name of a robot means that robot.
        - `after`: tasks that must be done before.
        - `same_robot_as`: a task whose robot must do this one too.
        - `robots`: number of robots that must work on it at the same time; the default is 1.
        - `parameters`: fields of that kind, named as in the messages, such as `{"look_at": (5, 1)}`.

        Args:
            task: a kind, such as `visit`, with the fields above; or a whole task, with only the times.
            **fields: fields of the task.

        Raises:
            BadTask: a field is missing or invalid.
            CallError: the task is refused, for example because no robot does its kind; the text gives the reason.
            NobodyThere: no coordinator answers, and no robot accepts the task.

        """
        asked = asked_task(task, self.by, f"{task}", fields, self._zone)
        if fields.get("id") is not None or not isinstance(task, str):
            return self._requests.submit(asked)

        def named(task_id: str) -> TaskSubmission:
            return msgspec.structs.replace(asked, task=msgspec.structs.replace(asked.task, id=task_id))

        def submit(task_id: str) -> TaskRecord:
            return self._requests.coordinator(TASK_SUBMIT, named(task_id))

        try:
            return self._fresh_ids.submit(task, submit, self.by)
        except NobodyThere as error:  # the coordinator's ids are not known: use a unique one
            return self._requests.submit_to_robots(named(f"{task}-{self._wire.clock.now_ns():x}"), error)

    def dry_run(self, task: str | Task, **fields: Unpack[TaskFields]) -> TaskDryRun:
        """Return the result of `submit` if it were called with these arguments. Nothing is submitted.

        Raises:
            BadTask: a field is missing or invalid.
            CallError: it is no valid task.
            NobodyThere: no coordinator answers.

        """
        asked = asked_task(task, self.by, f"{task}-dry-run", fields, self._zone)
        return self._requests.coordinator(TASK_DRY_RUN, asked)

    def _zone(self, name: str) -> Zone:
        """The zone of a name (BadTask if there is none)."""
        zones = self.zones()
        for zone in zones:
            if zone.name == name:
                return zone
        known = ", ".join(zone.name for zone in zones) or "none"
        raise BadTask(f"there is no place or zone {name}; known are {known}")

    def cancel(self, task: TaskName, why: str = "") -> TaskRecord:
        """Cancel a task; its robot stops it. Without a coordinator, robots are asked as by `submit`.

        Raises:
            CallError: it has already ended, or no such task is known.
            NobodyThere: no coordinator answers, and no robot accepts the cancellation.

        """
        return self._requests.cancel(TaskRequest(id=id_of(task), by=self.by, why=why))

    def cancel_all(self, which: TaskFilter, why: str = "") -> TaskRecords:
        """Cancel the open tasks that match, and return them.

        Raises:
            CallError: the team's rules do not allow it for one of them.
            NobodyThere: no coordinator answers.

        """
        return self._requests.coordinator(TASK_CHANGE, TaskUpdate(which=which, by=self.by, why=why, cancels=True))

    def change(self, tasks: Iterable[TaskName] | TaskFilter, **changes: Unpack[ChangeFields]) -> TaskRecords:
        """Change open tasks, given or selected, and return their records. Other fields stay as they are.

        A task whose robot or times change, or that is paused, is taken from its robot. It is offered again, from its
        beginning, once the robot has given it back; a paused one, once it is resumed.

        - `priority`: reward for doing it.
        - `earliest_s`: earliest start, seconds from now.
        - `deadline_s`: latest end, seconds from now.
        - `robot`: the robot that must do it.
        - `excluded`: a robot that must not do it.
        - `paused`: True pauses it, False resumes it.
        - `why`: the reason, for people.

        Args:
            tasks: ids or records of tasks; or a filter, which selects open tasks.
            **changes: as above.

        Raises:
            CallError: a task is unknown or has ended, or could not be done then.
            NobodyThere: no coordinator answers.

        """
        asked: dict[str, Any] = {AS_SENT.get(name, name): value for name, value in changes.items()}
        asked |= {"which": tasks} if isinstance(tasks, TaskFilter) else {"ids": [*map(id_of, tasks)]}
        return self._requests.coordinator(TASK_CHANGE, TaskUpdate(by=self.by, **asked))

    def get(self, task: TaskName) -> TaskRecord:
        """Return a task's record (CallError for an unknown id)."""
        return self._requests.coordinator(TASK_GET, TaskRequest(id=id_of(task)))

    def why(self, task: TaskName) -> TaskExplanation:
        """Explain a task's state, with each robot's cost or exclusion (CallError for an unknown id)."""
        return self._requests.coordinator(TASK_EXPLAIN, TaskRequest(id=id_of(task)))

    def list(self, wanted: TaskFilter | None = None) -> TaskRecords:
        """Return the matching tasks, in the order of acceptance."""
        return self._requests.coordinator(TASK_LIST, wanted or TaskFilter())

    def wait(self, task: TaskName, *, timeout_s: float | None = TASK_TIMEOUT_S) -> TaskRecord:
        """Wait until a task has ended, and return its record (TimeoutError if it has not in time)."""
        return self.wait_all([task], timeout_s=timeout_s)[0]

    def wait_all(self, tasks: Iterable[TaskName], *, timeout_s: float | None = TASK_TIMEOUT_S) -> TaskRecords:
        """Wait until all these tasks have ended, and return their records (TimeoutError if they have not in time)."""
        wanted = [id_of(task) for task in tasks]
        if wanted:
            for _ in self.events(wanted, timeout_s=timeout_s):
                pass
        return [self.get(task) for task in wanted]

    def events(self, tasks: Iterable[TaskName] = (), *, timeout_s: float | None = None) -> Iterator[TaskEvent]:
        """Yield each change of tasks, beginning with their present state, until all of them have ended.

        A change during a lost connection may be missed; the end of a task never is.

        Args:
            tasks: the tasks to follow; if empty, all tasks, without end.
            timeout_s: maximum duration; None for no limit.

        Raises:
            CallError: an id is unknown.
            NobodyThere: no coordinator answers.
            TimeoutError: they have not all ended in time.

        """
        wire, inbox = self._listening.open(), Inbox(4096)
        wire.subscribe(inbox, TASK_EVENT)
        return self._listening.until_done(wire, self._events(inbox, set(map(id_of, tasks)), timeout_s))

    # -- missions and rules -----------------------------------------------------------------------------------

    def start_mission(
        self, mission: str, *, id: str | None = None, parameters: Mapping[str, Any] | None = None
    ) -> MissionStatus:
        """Start a mission of the team's file; starting the same one with the same id again returns its state.

        Args:
            mission: its name among `[[missions]]`.
            id: name of what is started; None for a new one, such as `night-round-3`.
            parameters: values of its parameters; the defaults for those that are not given.

        Raises:
            CallError: there is no such mission or parameter, or a step is no valid task.
            NobodyThere: no coordinator answers.

        """

        def start(mission_id: str) -> MissionStatus:
            asked = MissionStart(id=mission_id, mission=mission, parameters=dict(parameters or {}), by=self.by)
            return self._requests.coordinator(mission_messages.MISSION_START, asked)

        return self._mission_ids.submit(mission, start, self.by) if id is None else start(id)

    def missions(self) -> MissionList:
        """Return the missions that are open, and the last that ended, in the order of their starts."""
        return self._requests.coordinator(mission_messages.MISSION_LIST, None)

    def cancel_mission(self, mission: str | MissionStatus, why: str = "") -> MissionStatus:
        """Cancel a mission and its tasks (CallError if it has ended, or is unknown)."""
        asked = TaskRequest(id=mission if isinstance(mission, str) else mission.id, by=self.by, why=why)
        return self._requests.coordinator(mission_messages.MISSION_CANCEL, asked)

    def rules(self) -> RuleTable:
        """Return the rules of the team, schedules included, and their states."""
        return self._requests.coordinator(rule_messages.COORDINATOR_RULES_NOW, None)

    def change_rules(self, *put: Rule, remove: Iterable[str] = ()) -> RuleTable:
        """Add rules, in place of those with their names, and remove others. All others keep their states.

        Returns:
            All rules of the team.

        Raises:
            CallError: a name to remove or a mission is not known, or there are too many rules.

        """
        change = RuleChange(put=[*put], remove=[*remove], by=self.by)
        return self._requests.coordinator(rule_messages.COORDINATOR_RULES_CHANGE, change)

    # -- planning ---------------------------------------------------------------------------------------------

    def kinds(self) -> KnownKinds:
        """Return the kinds of task that robots of the team do, each with the JSON Schema of its parameters."""
        return self._requests.coordinator(TASK_KINDS, None)

    def planning(self) -> PlanningStatus:
        """Return the state of planning."""
        return self._requests.coordinator(COORDINATOR_PLANNING, None)

    def set_objective(self, objective: Objective) -> PlanningStatus:
        """Change the planning objective."""
        return self._requests.coordinator(COORDINATOR_OBJECTIVE, ObjectiveRequest(objective=objective, by=self.by))

    def left(self) -> ExplorationLeft | None:
        """Return the regions that exploration has not covered, by the coordinator's map; None without a map."""
        return self._requests.coordinator(COORDINATOR_LEFT_NOW, None)

    def zone_times(self) -> Zones:
        """The zones that hold now, those that hold at other times, and when that changes."""
        return self._requests.coordinator(COORDINATOR_ZONES_NOW, None)

    def zones(self) -> ZoneList:
        """All zones and named places of the team, by name, also those that do not hold now."""
        return self.zone_times().all

    def change_zones(self, *put: Zone, remove: Iterable[str] = ()) -> ZoneList:
        """Add zones, in place of those with their names, and remove others.

        Returns:
            All zones of the team, by name.

        Raises:
            CallError: a name to remove is not known, or there are too many zones.

        """
        return self._change_zones(ZoneChange(put=[*put], remove=[*remove], by=self.by))

    def clear_zones(self, *names: str, for_s: float | None = None) -> ZoneList:
        """Have all robots leave zones and wait outside; tasks there and behind them wait.

        Args:
            names: of the zones.
            for_s: time after which they open; None until `open_zones`.

        Returns:
            All zones of the team, by name.

        Raises:
            CallError: a name is not known, or the zone is a point.

        """
        return self._change_zones(ZoneChange(clear=[*names], clear_s=for_s, by=self.by))

    def open_zones(self, *names: str) -> ZoneList:
        """Open zones that are cleared (CallError if a name is not known).

        Returns:
            All zones of the team, by name.

        """
        return self._change_zones(ZoneChange(open=[*names], by=self.by))

    def _change_zones(self, change: ZoneChange) -> ZoneList:
        return self._requests.coordinator(COORDINATOR_ZONES_CHANGE, change).all

    def hold_robot(
        self,
        robot: str,
        reason: str = "",
        *,
        gives_back: bool = False,
        pauses: bool = False,
        place: Point2D | Sequence[float] | str | None = None,
        retires: bool = False,
    ) -> None:
        """Take a robot out of service until `release_robot`: it gets no tasks.

        Args:
            robot: its name.
            reason: why, for people.
            gives_back: whether it gives its task back at once, for other robots; otherwise it finishes the task.
            pauses: whether it stops where it is instead, and continues its task once it is released.
            place: where it drives then, as for a task; None if it stays.
            retires: whether the team forgets the robot once it has left the network.

        Raises:
            CallError: no such robot is known.
            BadTask: no such place is known.

        """
        if isinstance(place, str):
            place = self._zone(place).centre
        elif place is not None and not isinstance(place, Point2D):
            place = Point2D(*place)
        hold = ServiceHold(
            robot=robot, reason=reason, gives_back=gives_back, pauses=pauses, place=place, retires=retires, by=self.by
        )
        self._requests.coordinator(COORDINATOR_HOLD_ROBOT, hold)

    def release_robot(self, robot: str) -> None:
        """Put a robot back into service (CallError if it is in service)."""
        self._requests.coordinator(COORDINATOR_RELEASE_ROBOT, ServiceRelease(robot=robot, by=self.by))

    def rename_robot(self, robot: str, label: str) -> None:
        """Give a robot a label, by which pages and tables show it; an empty one removes it.

        Raises:
            CallError: no such robot is known, or the label is the name or label of another one.

        """
        self._requests.coordinator(COORDINATOR_RENAME_ROBOT, RobotRename(robot=robot, label=label, by=self.by))

    def lead(self, *, by: str | None = None) -> Names:
        """Have a coordinator lead, by your word that no other journal has more and that silent robots do no tasks.

        A coordinator offers no task while most of its robots may be allocating tasks among themselves. A candidate does
        not lead while most witnesses are silent, or refuse it because its journal may lack acknowledged changes.

        Args:
            by: name of the sender, in place of the team's `by`.

        Returns:
            Names of the silent robots that do not count until their next message.

        """
        return self._requests.coordinator(COORDINATOR_LEAD, LeadRequest(by=self.by if by is None else by)).skipped

    def remove_robot(self, robot: str) -> None:
        """Have the coordinator forget a robot that has gone; until then it is shown as gone.

        Raises:
            CallError: the robot is unknown, is there, or may still do a task.

        """
        self._requests.coordinator(COORDINATOR_REMOVE_ROBOT, RobotRemoval(robot=robot, by=self.by))

    # -- robots -----------------------------------------------------------------------------------------------

    @property
    def robots(self) -> Names:
        """Names of the robots that are present, sorted."""
        return team_found(self._wire).robots

    @overload
    def state(self) -> TeamState: ...
    @overload
    def state(self, robot: str) -> RobotState: ...
    def state(self, robot: str | None = None) -> TeamState | RobotState:
        """Return the last state of a robot; without a name, the coordinator's last summary of the team.

        `stamp_ns` is the time of sending. The first call on a live team waits for at most 2 s.

        Raises:
            NobodyThere: no state was received; if the robot is absent, the text lists the present ones.

        """
        if robot is None:
            return self._last_states.team()
        return self._last_states.robot(robot)

    def readings(self, seconds: float, *, mote: str = "") -> Iterator[MoteReading]:
        """Yield readings of motes, published by robots and gateways, in order of arrival.

        Args:
            seconds: how long to listen.
            mote: only this mote; all if empty.

        """
        wire, inbox = self._listening.open(), Inbox(4096)
        wire.subscribe(inbox, MOTE_READING, **({"mote": mote} if mote else {}))
        return self._listening.until_done(wire, self._readings(inbox, seconds))

    # -- emergency halt ---------------------------------------------------------------------------------------

    def halt(self, robot: str | None = None, *, reason: str = "", by: str | None = None) -> HaltReport:
        """Halt all robots, or one, in an emergency. Robots have 2 s to confirm.

        Args:
            robot: halt only this one.
            reason: for the logs; truncated, as a halt message must be small.
            by: name to halt as, in place of the team's `by`. This name may end the halt, and any `operator…`.

        Returns:
            Which robots have confirmed that they stopped, and the state of the others.

        Raises:
            NobodyThere: no robot is present, or not that one. A halt of the team was sent anyway.

        """
        return self._order(robot, halted=True, reason=reason, by=by)

    def resume(self, robot: str | None = None, *, by: str | None = None) -> HaltReport:
        """End a halt of all robots, or of one; see `halt`. Those that stay halted are reported with the reason."""
        return self._order(robot, halted=False, reason="", by=by)

    def _order(self, robot: str | None, *, halted: bool, reason: str, by: str | None) -> HaltReport:
        who = cut(self.by if by is None or self._wire.member is not None else by, NAME_LENGTH)
        wanted = Halt(halted=halted, by=who, reason=cut(reason, REASON_LENGTH))
        if robot is not None:
            return order_robot(self._wire, robot, wanted)
        wire = self._listening.open()
        try:
            return TeamOrder(self.transport, self._halts, wire, wanted).report()
        finally:
            self._listening.end(wire)

    # -- the end ----------------------------------------------------------------------------------------------

    def close(self) -> None:
        """Close the connection; a team in lockstep ends."""
        try:
            self._listening.close()
        finally:
            self.transport.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _known_ids(self, kind: str) -> Names:
        return [record.task.id for record in self.list(TaskFilter(kinds=[kind], own=True))]

    def _is_known(self, task_id: str) -> bool:
        try:
            self.get(task_id)
        except CallError:
            return False
        return True

    def _events(self, inbox: Inbox, tasks: set[str], timeout_s: float | None) -> Iterator[TaskEvent]:
        transport = self.transport
        last: dict[str, int] = {}
        running = set(tasks)
        check_s = began_s = transport.elapsed_s()
        while True:
            received = [received.message for received in inbox.drain()]
            events = [event for event in received if not tasks or event.task.id in tasks]
            if transport.elapsed_s() >= check_s:
                events += [self.get(task).event for task in sorted(running)]
                check_s = transport.elapsed_s() + STREAM_CHECK_S
            for event in events:
                if event.change > last.get(event.task.id, 0):
                    last[event.task.id] = event.change
                    yield event
                if event.state.ended:
                    running.discard(event.task.id)
            if tasks and not running:
                return
            if timeout_s is not None and transport.elapsed_s() - began_s >= timeout_s:
                raise TimeoutError(f"not ended after {timeout_s:g} s: {', '.join(sorted(running)) or 'all tasks'}")
            transport.pass_time(POLL_S)

    def _readings(self, inbox: Inbox, seconds: float) -> Iterator[MoteReading]:
        ends_s = self.transport.elapsed_s() + seconds
        while (left_s := ends_s - self.transport.elapsed_s()) > 1e-9:
            self.transport.pass_time(min(left_s, POLL_S))
            yield from [received.message for received in inbox.drain()]
