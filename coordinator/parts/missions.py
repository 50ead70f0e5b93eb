"""Runs missions: makes the tasks of their steps in order, and does what they say about failed ones.

A mission is stored when it starts, when a step of it has ended, and when it ends. The tasks of its steps are ordinary
ones, whose ids follow from the mission's id and the step. A coordinator that starts again therefore finds each task
that was made, and makes those that are missing.
"""

from collections.abc import Callable, Sequence

import msgspec
from msgspec.structs import replace

from robrain.client.submission import BadTask
from robrain.coordinator.core.core import CoordinatorPart, Core
from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.parts.mission_forms import check_files_missions, check_steps, task_id_of, task_of_step
from robrain.coordinator.team.roster import Robot
from robrain.protocol.errors import BadName, CallError, ErrorCode
from robrain.protocol.keys import check_name
from robrain.protocol.messages.tasks.mission_messages import (
    MISSION_CANCEL,
    MISSION_LIST,
    MISSION_START,
    MissionStart,
    MissionState,
    MissionStatus,
    StepState,
    StepStatus,
)
from robrain.protocol.messages.tasks.task_messages import TaskRecord, TaskRequest
from robrain.protocol.messages.team.standing_messages import JournalAlarm
from robrain.protocol.messages.team.team_messages import TeamState
from robrain.protocol.model.rules.mission import MISSION, FailurePolicy, Mission, MissionOrder, MissionStep, check_order
from robrain.protocol.model.rules.template import fill
from robrain.protocol.model.tasks.task import Parameters, TaskState
from robrain.protocol.model.zone import Zone
from robrain.protocol.reasons import cancelled, plain
from robrain.protocol.wire.endpoint import Deferred, Request, Serve

OPEN_MAX = 100
"""Missions that are open at the same time."""
KEPT_ENDED = 50
"""Ended missions that are remembered, and the last of each name."""
SHOWN_ENDED = 5
"""Ended missions in the summary."""
BY = "mission:"
"""The requester of a mission's tasks is this and the mission's id."""


class StoredMission(msgspec.Struct, frozen=True, kw_only=True):
    """A mission that was started, as it stands."""

    id: str
    mission: Mission
    """As it was when the mission started."""
    parameters: Parameters
    """Values of all its parameters."""
    by: str
    started_ns: int
    parent: str = ""
    """The mission whose failed step it stands in for; empty if there is none."""
    state: MissionState = MissionState.RUNNING
    why: str = ""
    ended_ns: int = 0
    outcomes: dict[str, StepStatus] = {}
    """Steps that have ended, by name."""

    @property
    def due(self) -> list[MissionStep]:
        """Steps that have not ended, and all before them have."""
        if self.state.ended:
            return []
        steps = [step for step in self.mission.steps if step.name not in self.outcomes]
        return [step for step in steps if self.outcomes.keys() >= {*self.mission.after(step)}]


class StoredMissions(msgspec.Struct, frozen=True):
    """The missions that the part stores."""

    missions: dict[str, StoredMission] = {}
    """By id, in the order of their starts."""


class Missions(CoordinatorPart):
    """The missions of a team.

    Args:
        core: the team.
        missions: those that can be started.

    """

    def __init__(self, core: Core, missions: Sequence[Mission] = ()) -> None:
        super().__init__(core)
        check_files_missions(missions)
        self.known = {mission.name: mission for mission in missions}
        """Missions that can be started, by name."""
        self._book = core.tasks
        self._missions = self.stored(StoredMissions).missions
        self._seen_version = -1
        core.wire.answer(MISSION_START, self._start, serve=Serve.IN_STEP)
        core.wire.answer(MISSION_CANCEL, self._cancel, serve=Serve.IN_STEP)
        core.wire.answer(MISSION_LIST, lambda _: list(map(self._status, self._missions.values())), serve=Serve.IN_STEP)

    def is_open(self, mission_id: str) -> bool:
        """Whether a mission is known and has not ended."""
        found = self._missions.get(mission_id)
        return found is not None and not found.state.ended

    def open_by(self, by: str) -> list[str]:
        """Ids of the open missions of a requester."""
        return [each.id for each in self._open if each.by == by]

    def new_id(self, name: str) -> str:
        """An unused id for a mission of the coordinator's own."""
        while (found := self.core.new_id(name)) in self._missions:
            pass
        return found

    def summary(self, state: TeamState, now_ns: int) -> TeamState:
        """Add the missions."""
        if not self._missions:
            return state
        ended = [each for each in self._missions.values() if each.state.ended]
        return replace(
            state, missions=[replace(self._status(each), steps=[]) for each in self._open + ended[-SHOWN_ENDED:]]
        )

    def assign(self, robots: Sequence[Robot], now_ns: int) -> None:
        """Make the tasks that are due, if any task has changed."""
        if self._seen_version == self._book.version or not self._missions:
            return
        before = None
        while before is not self._missions:
            before = self._missions
            for each in self._open:
                self._advance(each)
        for record in self._book.open:
            mission = self._missions.get(record.by.removeprefix(BY)) if record.by.startswith(BY) else None
            if mission is not None and mission.state.ended:
                self._book.move(record.task.id, TaskState.CANCELLED, cancelled(record.by, mission.why))
                self.core.requests.has_changed = True
        self._seen_version = self._book.version

    def start(
        self, mission_id: str, order: MissionOrder, by: str, *, parent: str = "", alarm: JournalAlarm | None = None
    ) -> None:
        """Start a mission.

        Args:
            mission_id: an unused id.
            order: name and parameters.
            by: name of the requester.
            parent: the mission whose failed step it stands in for.
            alarm: source for which a rule starts it, stored in the same transaction.

        Raises:
            CallError: it is refused, in words.

        """
        try:
            check_name("mission", mission_id)
            check_order(f"mission {mission_id} is refused", order, self.known)
            mission = self.known[order.name]
            parameters = mission.parameters | order.parameters
            check_steps(mission, mission_id, parameters, self._zone)
            if used := [step.name for step in mission.steps if self._book.find(task_id_of(mission_id, step.name))]:
                raise ValueError(f"there is a task {task_id_of(mission_id, used[0])} already")
            if len(self._open) >= OPEN_MAX:
                raise ValueError(f"expected at most {OPEN_MAX} open missions")
            now_ns = self.core.wire.clock.now_ns()
            started = StoredMission(
                id=mission_id, mission=mission, parameters=parameters, by=by, started_ns=now_ns, parent=parent
            )
            self._put(started, alarm)
        except (ValueError, BadName, JournalUnwritable) as error:
            raise CallError(ErrorCode.REFUSED, str(error)) from error

    # -- requests -------------------------------------------------------------------------------------------

    def _start(self, request: Request[MissionStart]) -> Deferred[MissionStatus]:
        asked = request.asked
        known = self._missions.get(asked.id)
        if known is not None:
            parameters = known.mission.parameters | asked.parameters
            if (known.mission.name, known.parameters) != (asked.mission, parameters):
                raise CallError(ErrorCode.REFUSED, f"there is another mission {asked.id}")
            return self._once_kept(known.id)
        self._check_may_change(asked.id)
        self.start(asked.id, MissionOrder(name=asked.mission, parameters=asked.parameters), asked.by or request.by)
        return self._once_kept(asked.id)

    def _cancel(self, request: Request[TaskRequest]) -> Deferred[MissionStatus]:
        asked = request.asked
        self._check_may_change(asked.id)
        known = self._missions.get(asked.id)
        if known is None:
            raise CallError(ErrorCode.REFUSED, f"there is no mission {asked.id}")
        if known.state is MissionState.CANCELLED:
            return self._once_kept(asked.id)
        if known.state.ended:
            raise CallError(ErrorCode.REFUSED, f"mission {asked.id} has ended already: it is {known.state}")
        try:
            self._end(known, MissionState.CANCELLED, str(cancelled(asked.by or request.by, asked.why)))
        except JournalUnwritable as error:
            raise CallError(ErrorCode.REFUSED, f"mission {asked.id} is not cancelled: {error}") from error
        return self._once_kept(asked.id)

    def _once_kept(self, mission_id: str) -> Deferred[MissionStatus]:
        """The state of a mission, once no change up to now can be lost with this machine."""
        status = self._status(self._missions[mission_id])

        def when(answer: Callable[[MissionStatus | CallError], None]) -> None:
            def not_kept(reason: str) -> None:
                text = f"a change of mission {mission_id} may get lost: {reason}; ask again"
                answer(CallError(ErrorCode.FAILED, text, reason))

            self.core.parts.when_kept(lambda: answer(status), not_kept)

        return Deferred(when)

    def _check_may_change(self, mission_id: str) -> None:
        if refusal := self.core.parts.request_refusal():
            raise CallError(ErrorCode.REFUSED, f"mission {mission_id} is left as it is: {refusal}", refusal)

    def _status(self, one: StoredMission) -> MissionStatus:
        opened = {step.name: self._attempt(one, step)[1] for step in one.due}
        steps = [
            one.outcomes.get(step.name)
            or StepStatus(
                name=step.name,
                state=StepState.OPEN if step.name in opened else StepState.WAITING,
                task="" if (record := opened.get(step.name)) is None else record.task.id,
            )
            for step in one.mission.steps
        ]
        has_begun = one.outcomes or any(record and record.state is not TaskState.QUEUED for record in opened.values())
        return MissionStatus(
            id=one.id,
            mission=one.mission.name,
            state=MissionState.PENDING if one.state is MissionState.RUNNING and not has_begun else one.state,
            at=[step.name for step in steps if step.state in (StepState.OPEN, StepState.FAILED)],
            steps=steps,
            why=one.why,
            by=one.by,
            started_ns=one.started_ns,
            ended_ns=one.ended_ns,
        )

    # -- steps ----------------------------------------------------------------------------------------------

    @property
    def _open(self) -> list[StoredMission]:
        return [each for each in self._missions.values() if not each.state.ended]

    def _advance(self, one: StoredMission) -> None:
        """Make the tasks of a mission that are due, and store which steps have ended."""
        parent = self._missions.get(one.parent)
        if parent is not None and parent.state.ended:
            self._end(one, MissionState.CANCELLED, f"mission {parent.id} has ended")
            return
        found = [outcome for step in one.due if (outcome := self._outcome(one, step)) is not None]
        if not found:
            return
        one = replace(one, outcomes=one.outcomes | {outcome.name: outcome for outcome in found})
        failed = [outcome for outcome in found if outcome.state is StepState.FAILED]
        if failed:
            self._end(one, MissionState.FAILED, f"step {failed[0].name}: {failed[0].why}")
        elif len(one.outcomes) == len(one.mission.steps):
            self._end(one, MissionState.DONE)
        else:
            self._put(one)

    def _outcome(self, one: StoredMission, step: MissionStep) -> StepStatus | None:
        """How a step has ended; None if it is open, and its task has been made."""
        other_id = task_id_of(one.id, f"{step.name}.run")
        other = self._missions.get(other_id)
        attempt, record = self._attempt(one, step)
        task_id = task_id_of(one.id, step.name, attempt)
        if record is not None and record.by == BY + one.id:
            if not record.state.ended:
                return None
            if record.state is TaskState.DONE:
                return StepStatus(name=step.name, state=StepState.DONE, task=task_id)
            why = f"task {task_id}: {record.why or record.state}"
        elif record is not None:
            why = f"there is another task {task_id}"
        elif other is not None:
            why = other.why
        elif not (why := self._make(one, step, task_id)):
            return None
        policy, state = step.on_failure, StepState.FAILED
        if policy is FailurePolicy.SKIP:
            state = StepState.SKIPPED
        elif isinstance(policy, MissionOrder) and other is None:
            order = replace(policy, parameters=fill(policy.parameters, one.parameters))
            try:
                self.start(other_id, order, BY + one.id, parent=one.id)
            except CallError as error:
                _raise_unwritable(error)
                why = f"{why}; {error}"
            else:
                return None
        elif other is not None:
            if not other.state.ended:
                return None
            why = f"{why}; mission {other.id} is {other.state}"
            state = StepState.SKIPPED if other.state is MissionState.DONE else StepState.FAILED
        return StepStatus(name=step.name, state=state, task=task_id if record is not None else "", why=why)

    def _attempt(self, one: StoredMission, step: MissionStep) -> tuple[int, TaskRecord | None]:
        """The number of a step's last attempt, and its task; None if that is to be made."""
        attempt = 1
        while (record := self._book.find(task_id_of(one.id, step.name, attempt))) is not None:
            if record.state is not TaskState.FAILED or attempt > step.repeats:
                break
            attempt += 1
        return attempt, record

    def _make(self, one: StoredMission, step: MissionStep, task_id: str) -> str:
        """Make the task of a step; returns why it is refused, in words, or an empty text."""
        tasks = {name: outcome.task for name, outcome in one.outcomes.items()}
        reason = plain(
            "mission_step", f"step {step.name} of mission {one.id}", mission=one.id, step=step.name, by=one.by
        )
        try:
            asked = task_of_step(step, task_id, {**one.parameters, **tasks, MISSION: one.id}, self._zone)
            self.core.requests.admit(asked, BY + one.id, reason=reason)
        except CallError as error:
            _raise_unwritable(error)
            return error.message
        except BadTask as error:
            return str(error)
        self.core.assign_soon()
        return ""

    def _zone(self, name: str) -> Zone:
        if (zone := self.core.team_map.zone(name)) is None:
            raise BadTask(f"there is no place or zone {name}")
        return zone

    # -- storing --------------------------------------------------------------------------------------------

    def _end(self, one: StoredMission, state: MissionState, why: str = "") -> None:
        self._put(replace(one, state=state, why=why, ended_ns=self.core.wire.clock.now_ns()))

    def _put(self, one: StoredMission, alarm: JournalAlarm | None = None) -> None:
        missions = self._missions | {one.id: one}
        ended = [each for each in missions.values() if each.state.ended and not self.is_open(each.parent)]
        last = {each.mission.name: each.id for each in ended}
        for each in ended[:-KEPT_ENDED]:
            if last[each.mission.name] != each.id:
                del missions[each.id]
        self.store(StoredMissions(missions=missions), alarm)
        self._missions, self._seen_version = missions, -1
        self.core.assign_soon()
        self.core.report_soon()


def _raise_unwritable(error: CallError) -> None:
    """Raise the cause of a refusal if that is the journal, which may be writable later."""
    if isinstance(error.__cause__, JournalUnwritable):
        raise error.__cause__
