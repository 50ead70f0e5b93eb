"""What tasks take is asked of robots: once for all that are alike, without waiting; a silent robot is passed by."""

import pytest

from robrain.coordinator.tasks.task_costs import ANSWER_NS, PATIENCE_NS, TaskCosts
from robrain.coordinator.team.capabilities import Capabilities
from robrain.coordinator.team.roster import Robot
from robrain.protocol.clock import VirtualClock
from robrain.protocol.messages.robots.plugin_messages import ROBOT_PLUGINS, PluginInfo, TaskKind
from robrain.protocol.messages.tasks.offer_messages import ROBOT_COSTS, TaskCost
from robrain.protocol.model.energy_model import Work
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.wire.endpoint import Drive, Endpoint


class Team:
    """Robots that announce kinds and tell costs, and the coordinator's end of it."""

    def __init__(self, session) -> None:
        self.session, self.clock = session, VirtualClock()
        self.wire = self.endpoint()
        self.capabilities = Capabilities(self.wire)
        self.costs = TaskCosts(self.wire, self.capabilities)
        self.asked: list[tuple[str, list[str]]] = []
        self.silent: set[str] = set()
        self.told: dict[str, TaskCost] = {}
        self.robots: list[str] = []

    def endpoint(self) -> Endpoint:
        return Endpoint(self.session, "default", self.clock, Drive.LOCKSTEP)

    def robot(self, name: str, **kinds: int) -> None:
        wire = self.endpoint()
        infos = [
            PluginInfo(name=f"my_{kind}", level="behavior", state="active",
                       task_kind=TaskKind(kind=kind, settings=settings))
            for kind, settings in kinds.items()
        ]  # fmt: skip

        def costs(request):
            self.asked.append((name, [task.id for task in request.asked.tasks]))
            if name in self.silent:
                return b"null"
            return [self.told.get(task.id, TaskCost(id=task.id, wait_s=7.0)) for task in request.asked.tasks]

        wire.answer(ROBOT_PLUGINS, lambda _request: infos, robot=name)
        wire.answer(ROBOT_COSTS, costs, robot=name)
        self.robots.append(name)
        self.capabilities.follow([Robot(name) for name in self.robots], self.clock.now_ns())
        self.capabilities.follow([Robot(name) for name in self.robots], self.clock.now_ns())

    def follow(self, *tasks: Task, times: int = 2) -> None:
        for _ in range(times):
            self.costs.follow(tasks, self.robots, self.clock.now_ns())


@pytest.fixture
def team(lockstep_session):
    return Team(lockstep_session)


def sweep(number: int = 1, **fields) -> Task:
    return Task(id=f"s{number}", kind="sweep", place=Point2D(float(number), 0.0), **fields)


def test_many_tasks_are_asked_for_in_one_query(team: Team) -> None:
    team.robot("r1", sweep=1)
    tasks = [sweep(number, parameters={"side_m": number}) for number in range(40)]
    team.follow(*tasks)
    assert team.asked == [("r1", [task.id for task in tasks])]
    assert all(team.costs.of(task) == (Work(wait_s=7.0),) for task in tasks)
    assert not team.costs.is_waiting


def test_an_answer_holds_for_all_tasks_with_the_same_parameters_and_all_robots_of_a_type(team: Team) -> None:
    team.robot("r1", sweep=1)
    team.robot("r2", sweep=1)
    team.follow(sweep(1))
    team.follow(sweep(1), sweep(2))
    assert team.asked == [("r1", ["s1"])]
    assert team.costs.of(sweep(2)) == (Work(wait_s=7.0),)
    team.follow(sweep(1), sweep(2), sweep(3, service_s=5.0))
    assert team.asked[1:] == [("r1", ["s3"])]


def test_what_was_known_holds_until_a_new_type_of_robot_has_answered(team: Team) -> None:
    team.robot("r1", sweep=1)
    team.follow(sweep(1))
    team.silent = {"r2"}
    team.clock.advance_to(100 * PATIENCE_NS)
    team.robot("r2", sweep=2)
    team.follow(sweep(1))
    assert team.asked[-1] == ("r2", ["s1"])
    assert team.costs.of(sweep(1)) == (Work(wait_s=7.0),)
    team.silent.clear()
    team.told["s1"] = TaskCost(id="s1", wait_s=9.0)
    team.clock.advance_to(100 * PATIENCE_NS + ANSWER_NS + 1)
    team.follow(sweep(1))
    assert team.costs.of(sweep(1)) == (Work(wait_s=7.0), Work(wait_s=9.0))


def test_a_silent_robot_is_passed_by_and_without_any_answer_the_task_waits_no_longer(team: Team) -> None:
    team.robot("r1", sweep=1)
    team.robot("r2", sweep=1)
    team.silent = {"r1", "r2"}
    team.follow(sweep(1))
    assert team.asked == [("r1", ["s1"])]
    assert team.costs.of(sweep(1)) is None
    assert team.costs.is_waiting
    team.clock.advance_to(ANSWER_NS + 1)
    team.follow(sweep(1))
    assert team.asked == [("r1", ["s1"]), ("r2", ["s1"])]
    team.clock.advance_to(PATIENCE_NS + 1)
    team.follow(sweep(1))
    assert team.costs.of(sweep(1)) == ()
    assert not team.costs.is_waiting


def test_the_next_task_of_robots_that_never_answer_does_not_wait_and_a_late_answer_counts(team: Team) -> None:
    team.robot("r1", sweep=1)
    team.silent = {"r1"}
    team.follow(sweep(1))
    team.clock.advance_to(PATIENCE_NS + 1)
    team.follow(sweep(1))
    team.follow(sweep(1), sweep(2, service_s=1.0))
    assert team.costs.of(sweep(2, service_s=1.0)) == ()
    assert team.asked[-1] == ("r1", ["s2"])
    team.silent.clear()
    team.follow(sweep(3, service_s=2.0))
    assert team.costs.of(sweep(3, service_s=2.0)) == ()
    team.follow(sweep(4, service_s=2.0))
    assert team.costs.of(sweep(4, service_s=2.0)) == (Work(wait_s=7.0),)


def test_answers_that_nobody_asked_for_are_not_believed(team: Team) -> None:
    team.robot("r1", sweep=1)
    team.told["s1"] = TaskCost(id="another", wait_s=1e5)
    team.follow(sweep(1), sweep(2, service_s=1.0))
    assert team.costs.of(sweep(1)) is None
    assert team.costs.of(sweep(2, service_s=1.0)) == (Work(wait_s=7.0),)
