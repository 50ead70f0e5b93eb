"""With random words in place of every reason's sentence the same is planned, offered and charged."""

from collections.abc import Iterator
from contextlib import contextmanager

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robrain.algorithms.allocation.explain import explain
from robrain.coordinator.charging import is_for_energy
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import BelowReserve, HolderLacksEnergy, LacksEnergy, NearestOut, NeedsEnergy, plain
from robrain.protocol.table.topics import COORDINATOR_CHARGES, TASK_DECISION, TASK_EVENT, TASK_PROBLEM
from robrain.protocol.wire.session import open_lockstep_session
from tests.algorithms.allocation.test_allocators import ITERATIONS, allocators, problems
from tests.coordinator.conftest import FakeRobot, Team
from tests.coordinator.planning.worlds import CAPACITY_J, Worker, run
from tests.random_words import MEANINGLESS, MISLEADING, speak_at_random, wordless

RELUCTANT_FOR = ("t1", "t3", "t5")
DOCK = Point2D(3.5, 2.5)
TOLD = (TASK_PROBLEM, TASK_DECISION, TASK_EVENT, COORDINATOR_CHARGES)
TIRED, FRESH = (0.2, 0.18, 0.16), (0.9, 0.9, 0.9)
"""States of charge: all have to charge first, or nobody has to."""
LONGEST_S = 200.0
GIVE_UP_S = 30.0
HEAVY_S = 20_000.0
"""Of standing takes more than a battery holds."""


class Reluctant(FakeRobot):
    """Refuses some tasks once, for lack of energy."""

    def come(self) -> None:
        self._refused: set[str] = set()
        super().come()

    def _offered(self, request) -> TaskAnswer:
        task = request.asked.task.id
        if task in RELUCTANT_FOR and task not in self._refused:
            self._refused.add(task)
            self.offers.append(request.asked)
            return TaskAnswer.refused(NeedsEnergy(9.0, 8.0))
        return super()._offered(request)


def a_day_at_work(socs: tuple[float, float, float]) -> tuple[list[object], Team]:
    """What three robots with one charger are told and asked, words left out."""
    with open_lockstep_session() as session:
        team = Team(session)
        team.begin(None, PlanningPolicy(give_up_s=GIVE_UP_S))
        ears = Inbox(100_000, every=True)
        for topic in TOLD:
            team.endpoint().subscribe(ears, topic)
        crew = []
        for number, soc in enumerate(socs, start=1):
            robot = Reluctant(team, f"r{number}", 4.0 + number, 4.0) if number == 3 else None
            if robot is None:
                robot = team.robot(f"r{number}", 4.0 + number, 4.0)
            else:
                team.robots.append(robot)
            robot.plugins, robot.chargers = ["visit", "recharge"], [DOCK]
            crew.append(Worker(robot, remaining_j=soc * CAPACITY_J, dearer=100.0))
        team.closed_room()
        run(team, crew, 1.0)
        for number in range(10):
            team.submit(
                Task(
                    id=f"t{number}", kind="visit", place=Point2D(8.6 - 0.1 * number, 5.6 - 0.35 * number), service_s=1.0
                )
            )
        team.submit(Task(id="late", kind="visit", place=Point2D(8.5, 5.5)), deadline_in_s=2.0)
        team.submit(Task(id="after_late", kind="visit", place=Point2D(8.5, 5.5), after=("late",)))
        team.submit(Task(id="heavy", kind="visit", place=Point2D(6.0, 5.0), service_s=HEAVY_S))
        team.submit(Task(id="pair", kind="visit", place=Point2D(6.0, 4.0), robots=2))
        run(team, crew, LONGEST_S, until=lambda: all(state.ended for state in team.states().values()))
        told = [(one.topic.name, wordless(one.message)) for one in ears.drain()]
        asked = [(worker.robot.name, wordless(list(worker.robot.offers))) for worker in crew]
        team.close()
        return [*told, *asked], team


@pytest.fixture(scope="module")
def tired() -> tuple[list[object], Team]:
    return a_day_at_work(TIRED)


@pytest.fixture(scope="module")
def fresh() -> tuple[list[object], Team]:
    return a_day_at_work(FRESH)


@contextmanager
def random_words(seed: int, vocabulary: tuple[str, ...] = MISLEADING) -> Iterator[list[str]]:
    with pytest.MonkeyPatch.context() as patch:
        yield speak_at_random(patch, seed, vocabulary)


def codes(team: Team) -> set[str]:
    return {event.reason.code for event in team.heard if event.reason is not None}


def test_the_days_have_what_decisions_could_be_read_from(tired, fresh) -> None:
    for _, team in (tired, fresh):
        assert {"gave_up", "deadline_passed", "after_ended", "waits_for_charge"} <= codes(team)
        assert set(team.states().values()) == {TaskState.DONE, TaskState.FAILED, TaskState.CANCELLED}
    assert {"robot_out", "charged_enough"} <= codes(tired[1])
    assert "nearest_out" in codes(fresh[1])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("socs", "seed", "vocabulary"), [(TIRED, 1, MISLEADING), (TIRED, 1, MEANINGLESS), (FRESH, 2, MISLEADING)]
)
def test_the_same_is_planned_offered_and_charged_whatever_the_reasons_are_called(
    tired, fresh, socs, seed, vocabulary
) -> None:
    with random_words(seed, vocabulary) as said:
        told, _ = a_day_at_work(socs)
    assert len(set(said)) > 20
    assert told == (tired if socs is TIRED else fresh)[0]


def without_words(value: object) -> object:
    """A value in plain types, without the sentences of reasons."""
    match value:
        case dict():
            return {key: without_words(one) for key, one in value.items() if key not in ("text", "why", "refusal")}
        case list() | tuple():
            return [without_words(one) for one in value]
        case msgspec.Struct():
            return without_words(msgspec.to_builtins(value))
    return value


@pytest.mark.slow
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(problem=problems(), objective=st.sampled_from(Objective), seed=st.integers(0, 1000))
def test_allocators_plan_the_same_whatever_the_reasons_are_called(problem, objective, seed) -> None:
    for allocator in allocators(objective):
        plan = allocator.plan(problem, iterations=ITERATIONS, seed=seed)
        decisions = without_words(explain(problem, plan))
        with random_words(seed):
            other = allocator.plan(problem, iterations=ITERATIONS, seed=seed)
            assert without_words(other) == without_words(plan)
            assert without_words(explain(problem, other)) == decisions


@pytest.mark.parametrize(
    ("reason", "is_so"),
    [
        (NearestOut("r1", LacksEnergy(7.0)), True),
        (NearestOut("r1", BelowReserve(0.03, 0.1)), True),
        (HolderLacksEnergy("r1"), True),
        (NearestOut("reserve", plain("crowded", "words")), False),
        (NearestOut("lacks 7 J", plain("no_way_and_back", "words")), False),
        (plain("holder_late", "words"), False),
        (plain("no_robots", "words"), False),
    ],
)
def test_whether_energy_is_what_a_task_wants_is_no_matter_of_names(reason, is_so) -> None:
    assert is_for_energy(reason) is is_so
