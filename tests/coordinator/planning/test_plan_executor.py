"""What is due by the plan is offered, a few in each step; what is taken is told, and so is what is left out."""

from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from robrain.coordinator.core.core import Parts
from robrain.coordinator.planning.plan_executor import CHECK_NS, PlanExecutor
from robrain.coordinator.planning.planning import Due, Unplanned
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.task_explanation import TaskExplainer
from robrain.coordinator.tasks.task_book import TaskBook
from robrain.coordinator.tasks.task_lifecycle import TaskLifecycle
from robrain.coordinator.team.capabilities import Capabilities
from robrain.coordinator.team.roster import Roster
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.messages.robots.robot_messages import RobotState, TaskStatus
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import LacksEnergy, NearestOut, Refused, RobotOut, TaskReason, needed_for, no_path, plain
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.presence import Change
from robrain.protocol.wire.session import open_lockstep_session
from tests.plain_reason import Plain

PLACE = Point2D(1.0, 1.0)
GIVE_UP_S = 60.0


class Plan:
    """A plan as `PlanExecutor` asks it."""

    def __init__(self) -> None:
        self.number, self.is_on = 1, True
        self.policy = PlanningPolicy(give_up_s=GIVE_UP_S)
        self.offers: list[Due] = []
        self.left_out: dict[str, Unplanned] = {}
        self.taken: list[tuple[str, str]] = []
        self.is_anybody_out = False

    def due(self, _now_ns: int) -> list[Due]:
        return self.offers

    def exclusion(self, _robot: object, _now_ns: int) -> None:
        """No robot is excluded."""

    def begun(self, task_id: str, robot: str) -> None:
        self.taken.append((task_id, robot))

    def anybody_out(self, _now_ns: int) -> bool:
        return self.is_anybody_out


def lacks(robot: str, missing_j: float) -> NearestOut:
    return NearestOut(robot, LacksEnergy(missing_j))


class Office:
    """Tasks, robots r0 and on, and offers that go nowhere."""

    def __init__(self, wire: Endpoint) -> None:
        self.book = TaskBook(wire.clock, 0, lambda event: self.told.append((event.task.id, event.reason)))
        self.told: list[tuple[str, TaskReason | None]] = []
        self.roster = Roster()
        self.tasks = TaskLifecycle(wire, self.book, self.roster, Capabilities(wire), Parts())
        self.offered: list[tuple[str, str, str]] = []
        self.tasks._offers = SimpleNamespace(offer=self._send, answered=list)
        self.refuses: set[str] = set()
        self.plan = Plan()
        self.explanation = TaskExplainer(self.tasks, self.plan, Parts().verdicts)
        coalitions = SimpleNamespace(step=lambda _now_ns: None)
        self.executor = PlanExecutor(self.plan, self.tasks, self.explanation, coalitions)

    def step(self, now_ns: int) -> bool:
        return self.executor.step([], now_ns, is_halted=False)

    def robot(self, name: str, task: TaskStatus | None = None) -> None:
        self.roster.record_presence(Change({"robot": name}, True))
        self.roster.record_state(RobotState(robot=name, task=task), 0)

    def add(self, *names: str, **fields) -> None:
        for name in names:
            self.book.add(Task(id=name, kind="visit", place=PLACE, **fields))

    def state(self, name: str) -> TaskState:
        return self.book.find(name).state

    def _send(self, record, after: str) -> None:
        self.offered.append((record.task.id, record.robot, after))
        if record.robot in self.refuses:
            self.book.give_back(record.task.id, RobotOut(record.robot, Refused(no_path())))


@pytest.fixture
def office() -> Iterator[Office]:
    with open_lockstep_session() as session:
        wire = Endpoint(session, "default", VirtualClock(), Drive.LOCKSTEP)
        yield Office(wire)
        wire.close()


# -- what is due ----------------------------------------------------------------------------------------------------


def test_what_a_robot_explores_is_called_off_for_a_task(office):
    office.robot("r1")
    office.book.add(Task(id="explore-1", kind="explore", place=PLACE), own=True)
    office.tasks.offer("explore-1", "r1", 0)
    office.add("t1")
    office.plan.offers = [Due("t1", "r1", "")]
    office.step(0)
    assert office.state("explore-1") is TaskState.CANCELLED
    assert ("explore-1", needed_for("r1", "t1")) in office.told
    assert office.state("t1") is TaskState.OFFERED


def test_a_task_for_later_that_a_robot_may_not_be_given_now_keeps_nothing_else_waiting(office):
    office.robot("r1")
    office.robot("r2")
    office.add("t1", "t2")
    office.tasks.may_be_next = lambda robot, after: False
    office.plan.offers = [Due("t1", "r1", "t0"), Due("t2", "r2", "")]
    assert not office.step(0)
    assert office.offered == [("t2", "r2", "")]


# -- what is left out -----------------------------------------------------------------------------------------------


def test_why_a_task_is_left_out_is_told_once(office):
    office.add("t1")
    office.plan.left_out = {"t1": Unplanned(lacks("r1", 20.0), 0)}
    office.step(0)
    office.plan.number = 2
    office.step(1)
    assert office.told[1:] == [("t1", lacks("r1", 20.0))]
    office.plan.number = 3
    office.plan.left_out = {"t1": Unplanned(lacks("r1", 31.5), 0)}
    office.step(2)
    assert office.told[2:] == [], "only its figure is another"
    office.plan.number = 4
    office.plan.left_out = {"t1": Unplanned(lacks("r2", 31.5), 0)}
    office.step(3)
    assert office.told[2:] == [], "names of robots differ by figures too"
    office.plan.number = 5
    office.plan.left_out = {"t1": Unplanned(NearestOut("r2", plain("no_way_and_back", "words")), 0)}
    office.step(4)
    assert office.told[2:] == [("t1", NearestOut("r2", plain("no_way_and_back", "words")))]


def test_while_the_plan_stays_the_same_what_is_left_out_is_looked_at_every_five_seconds(office):
    office.add("t1")
    now_ns = to_ns(100.0)
    office.step(now_ns)
    office.plan.left_out = {"t1": Unplanned(lacks("r1", 20.0), now_ns)}
    office.step(now_ns + CHECK_NS - 1)
    assert office.told[1:] == []
    office.step(now_ns + CHECK_NS)
    assert office.told[1:] == [("t1", lacks("r1", 20.0))]


@pytest.mark.parametrize(
    ("deadline", "after_ns", "state"),
    [
        ({}, to_ns(GIVE_UP_S), TaskState.QUEUED),
        ({}, to_ns(GIVE_UP_S) + 1, TaskState.FAILED),
        ({"deadline_ns": to_ns(10 * GIVE_UP_S)}, to_ns(2 * GIVE_UP_S), TaskState.QUEUED),
    ],
)
def test_a_task_that_is_left_out_waits_for_its_deadline_or_fails_after_a_while(office, deadline, after_ns, state):
    office.add("t1", **deadline)
    office.plan.left_out = {"t1": Unplanned(lacks("r1", 20.0), 0)}
    office.step(after_ns)
    assert office.state("t1") is state
    assert office.told[-1][1] == (Plain("gave_up") if state is TaskState.FAILED else lacks("r1", 20.0))


def test_nothing_is_told_of_a_task_that_is_gone_begun_or_paused(office):
    office.robot("r1")
    office.add("t1", "t2")
    office.tasks.offer("t1", "r1", 0)
    office.tasks.backoff.record("t2", "r1", Refused(no_path()), 0)
    before = len(office.told)
    office.plan.left_out = {name: Unplanned(lacks("r1", 20.0), 0) for name in ("gone", "t1", "t2")}
    office.step(1)
    assert office.told[before:] == []


@pytest.mark.parametrize("is_anybody_out", [False, True])
@pytest.mark.parametrize("able_but_out", [False, True])
def test_a_task_that_a_robot_could_do_which_is_out_now_is_not_given_up(office, is_anybody_out, able_but_out):
    office.add("t1")
    office.plan.is_anybody_out = is_anybody_out
    office.explanation.able_but_out = lambda record, now_ns: able_but_out
    office.plan.left_out = {"t1": Unplanned(lacks("r2", 20.0), 0)}
    office.step(to_ns(2 * GIVE_UP_S))
    is_kept = is_anybody_out and able_but_out
    assert office.state("t1") is (TaskState.QUEUED if is_kept else TaskState.FAILED)
