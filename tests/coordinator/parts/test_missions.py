"""Missions make the tasks of their steps in order, and follow their rules for failed ones."""

import sqlite3

import msgspec
import pytest

from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.parts.missions import KEPT_ENDED, OPEN_MAX
from robrain.coordinator.planning.policy import NEAREST, PlanningPolicy
from robrain.protocol.errors import CallError, NobodyThere
from robrain.protocol.messages.tasks.mission_messages import (
    MISSION_CANCEL,
    MISSION_LIST,
    MISSION_START,
    MissionStart,
    MissionState,
    MissionStatus,
    StepState,
)
from robrain.protocol.messages.tasks.task_messages import TASK_CANCEL, TaskFilter, TaskRequest
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.rules.mission import Mission
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.model.zone import ZoneKind, ZoneTable

NO_PLANS = PlanningPolicy(
    method=NEAREST, zones=(ZoneTable(name="gate-2", kind=ZoneKind.PLACE, corners_m=((5.0, 3.0),)),)
)
A, B = {"kind": "visit", "place": [5.0, 4.0]}, {"kind": "visit", "place": [7.0, 4.0]}
IN_WALL = {"kind": "visit", "place": [2.95, 3.0]}
TOO_LATE = {"kind": "visit", "place": [5.0, 4.0], "service_s": 9.0, "deadline_in_s": 5.0}
"""A task that is refused by any coordinator, whatever it knows."""


def mission(name="round", *steps, **fields) -> Mission:
    return msgspec.convert({"name": name, "steps": steps, **fields}, Mission)


def step(name, task=A, **fields):
    return {"name": name, "task": task, **fields}


class MissionTeam:
    """One robot in a closed room, and missions."""

    def __init__(self, team, *missions, journal=None):
        self.team, self.missions = team, missions
        self.journal = Journal() if journal is None else journal
        self.restart()
        self.robot = team.robot("r1", 4.5, 3.0)
        team.closed_room()
        team.run(1.0)

    def restart(self):
        self.team.begin(self.journal, NO_PLANS, missions=self.missions)

    def start(self, name="round", id="m1", **parameters):
        asked = MissionStart(id=id, mission=name, parameters=parameters, by="me")
        return self.team.ask(MISSION_START, asked, MissionStatus)

    def cancel(self, id="m1", why="rain"):
        return self.team.ask(MISSION_CANCEL, TaskRequest(id=id, by="me", why=why), MissionStatus)

    def status(self, id="m1"):
        return next(one for one in self.team.ask(MISSION_LIST, None, list[MissionStatus]) if one.id == id)

    def steps(self, id="m1"):
        return {one.name: one.state for one in self.status(id).steps}

    def end(self, state=TaskState.DONE, why="", run_s=1.0):
        """The robot ends its task."""
        self.robot.end(state, why)
        self.team.run(run_s)

    def fail(self, attempts=3):
        """All attempts of the robot at a task fail."""
        for _ in range(attempts):
            self.end(TaskState.FAILED, "stuck", run_s=30.0)

    def tasks(self):
        return {record.task.id: record.state for record in self.journal.select(TaskFilter())}


def test_steps_are_done_in_turn_and_the_mission_is_done_with_the_last(team):
    missions = MissionTeam(team, mission("round", step("a"), step("b", B)))
    assert missions.start().state is MissionState.PENDING
    assert missions.tasks() == {}
    team.run(1.0)
    status = missions.status()
    assert (status.state, status.at, status.by) == (MissionState.RUNNING, ["a"], "me")
    assert missions.tasks() == {"m1.a": TaskState.RUNNING}
    assert missions.journal.select(TaskFilter())[0].by == "mission:m1"
    missions.end()
    assert missions.tasks() == {"m1.a": TaskState.DONE, "m1.b": TaskState.RUNNING}
    assert missions.robot.goal == Point2D(7.0, 4.0)
    assert missions.status().at == ["b"]
    missions.end()
    status = missions.status()
    assert (status.state, status.at, status.why) == (MissionState.DONE, [], "")
    assert status.ended_ns > status.started_ns > 0
    assert [one.state for one in team.summary.missions] == [MissionState.DONE]


def test_a_mission_is_pending_until_a_robot_begins(team):
    missions = MissionTeam(team, mission("round", step("a")))
    missions.robot.accepts = False
    missions.start()
    team.run(0.3)
    assert missions.status().state is MissionState.PENDING
    assert missions.tasks() == {"m1.a": TaskState.QUEUED}


def test_steps_without_an_order_are_open_at_once_and_a_later_one_waits_for_both(team):
    missions = MissionTeam(team, mission("round", step("a"), step("b", B, after=[]), step("c", A, after=["a", "b"])))
    missions.start()
    team.run(1.0)
    assert missions.status().at == ["a", "b"]
    missions.end()
    assert missions.status().at == ["b"]
    missions.end()
    assert missions.status().at == ["c"]


# -- failed steps -----------------------------------------------------------------------------------------------------


def test_a_failed_step_stops_its_mission_and_cancels_its_other_tasks(team):
    missions = MissionTeam(team, mission("round", step("a"), step("b", B, after=[]), step("c", IN_WALL, after=["a"])))
    missions.start()
    team.run(1.0)
    missions.end()
    assert missions.tasks() == {"m1.a": TaskState.DONE, "m1.b": TaskState.CANCELLED}
    assert missions.status().state is MissionState.FAILED


def test_the_steps_after_a_failed_one_are_not_made(team):
    missions = MissionTeam(team, mission("round", step("a"), step("b")))
    missions.start()
    team.run(1.0)
    missions.fail()
    assert missions.tasks() == {"m1.a": TaskState.FAILED}
    status = missions.status()
    assert (status.state, status.at) == (MissionState.FAILED, ["a"])
    assert status.why.startswith("step a: task m1.a: ")
    assert "stuck" in status.why
    assert missions.steps()["b"] is StepState.WAITING


def test_a_failed_step_is_skipped_if_it_may_be(team):
    missions = MissionTeam(team, mission("round", step("a", on_failure="skip"), step("b", B)))
    missions.start()
    team.run(1.0)
    missions.fail()
    assert missions.status().at == ["b"]
    missions.end()
    assert missions.status().state is MissionState.DONE
    assert missions.steps() == {"a": StepState.SKIPPED, "b": StepState.DONE}


def test_a_failed_step_is_repeated_as_often_as_it_says(team):
    missions = MissionTeam(team, mission("round", step("a", repeats=2)))
    missions.start()
    team.run(1.0)
    missions.fail()
    assert missions.tasks() == {"m1.a": TaskState.FAILED, "m1.a.2": TaskState.RUNNING}
    assert missions.status().steps[0].task == "m1.a.2"
    missions.fail()
    missions.fail()
    assert missions.tasks() == dict.fromkeys(["m1.a", "m1.a.2", "m1.a.3"], TaskState.FAILED)
    assert missions.status().state is MissionState.FAILED


def test_a_failed_step_runs_another_mission_and_continues_once_that_is_done(team):
    rescue = mission("rescue", step("b", {"kind": "visit", "place": ["{x_m}", 5.0]}), parameters={"x_m": 4.0})
    run = {"name": "rescue", "parameters": {"x_m": "{y_m}"}}
    missions = MissionTeam(
        team, mission("round", step("a", on_failure=run), step("c"), parameters={"y_m": 8.0}), rescue
    )
    missions.start()
    team.run(1.0)
    missions.fail()
    assert missions.status().at == ["a"]
    assert missions.status("m1.a.run").at == ["b"]
    assert missions.robot.goal == Point2D(8.0, 5.0)
    missions.end()
    assert missions.status("m1.a.run").state is MissionState.DONE
    assert missions.steps() == {"a": StepState.SKIPPED, "c": StepState.OPEN}


def test_a_mission_fails_with_the_one_that_a_step_of_it_runs(team):
    missions = MissionTeam(
        team, mission("round", step("a", on_failure={"name": "rescue"})), mission("rescue", step("b", B))
    )
    missions.start()
    team.run(1.0)
    missions.fail()
    missions.fail()
    assert missions.status("m1.a.run").state is MissionState.FAILED
    assert missions.status().state is MissionState.FAILED
    assert missions.status().why.endswith("mission m1.a.run is failed")


def test_a_task_that_is_refused_is_a_failed_step(team):
    missions = MissionTeam(team, mission("round", step("a", IN_WALL, repeats=5, on_failure="skip"), step("b", IN_WALL)))
    missions.start()
    team.run(1.0)
    assert missions.tasks() == {}
    assert missions.steps() == {"a": StepState.SKIPPED, "b": StepState.FAILED}
    assert "is in a wall" in missions.status().why


def test_a_task_that_a_person_cancels_is_a_failed_step_and_is_not_repeated(team):
    missions = MissionTeam(team, mission("round", step("a", repeats=5)))
    missions.start()
    team.run(1.0)
    team.ask(TASK_CANCEL, TaskRequest(id="m1.a", by="me", why="fire"))
    team.run(1.0)
    assert missions.tasks() == {"m1.a": TaskState.CANCELLED}
    assert missions.status().why == "step a: task m1.a: cancelled by me: fire"


def test_a_task_of_the_same_id_by_another_requester_is_no_step(team):
    missions = MissionTeam(team, mission("round", step("a"), step("b")))
    missions.start()
    team.run(1.0)
    team.submit(Task(id="m1.b", kind="visit", place=Point2D(5.0, 3.0)))
    missions.end()
    assert missions.status().why == "step b: there is another task m1.b"


# -- requests ---------------------------------------------------------------------------------------------------------


def test_a_cancelled_mission_cancels_its_tasks_and_those_of_missions_that_it_runs(team):
    missions = MissionTeam(
        team, mission("round", step("a", on_failure={"name": "rescue"})), mission("rescue", step("b", B))
    )
    missions.start()
    team.run(1.0)
    missions.fail()
    assert missions.tasks()["m1.a.run.b"] is TaskState.RUNNING
    assert missions.cancel().why == "cancelled by me: rain"
    team.run(1.0)
    assert missions.tasks()["m1.a.run.b"] is TaskState.CANCELLED
    assert missions.robot.withdrawals[-1].id == "m1.a.run.b"
    assert missions.status("m1.a.run").state is MissionState.CANCELLED
    assert missions.cancel().state is MissionState.CANCELLED


def test_the_same_start_again_changes_nothing_and_another_one_of_that_id_is_refused(team):
    missions = MissionTeam(team, mission("round", step("a"), parameters={"x": 1}))
    missions.start(x=2)
    team.run(1.0)
    assert missions.start(x=2).at == ["a"]
    with pytest.raises(CallError, match="there is another mission m1"):
        missions.start(x=3)
    missions.end()
    assert missions.start(x=2).state is MissionState.DONE
    with pytest.raises(CallError, match="mission m1 has ended already: it is done"):
        missions.cancel()
    with pytest.raises(CallError, match="there is no mission m2"):
        missions.cancel("m2")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"name": "dance"}, "there is no mission dance; known are round"),
        ({"y": 1}, "mission round has no parameter y; it has floor, stay_s"),
        ({"floor": 3}, "mission round, step a: task: there is no place or zone gate-3"),
        ({"stay_s": "long"}, "mission round, step a: task: service_s: Expected `float`, got `str`"),
        ({"id": "m/1"}, "/ may not stand in a name"),
        ({"id": "m" * 63}, "it is longer than 63 characters"),
        ({"id": "taken"}, "there is a task taken.a already"),
    ],
)
def test_a_start_that_cannot_be_is_refused(team, given, said):
    task = {"kind": "visit", "place": "gate-{floor}", "service_s": "{stay_s}"}
    missions = MissionTeam(team, mission("round", step("a", task), parameters={"floor": 2, "stay_s": 1.0}))
    team.submit(Task(id="taken.a", kind="visit", place=Point2D(5.0, 3.0)))
    with pytest.raises(CallError, match=said.replace("[", r"\[")):
        missions.start(**given)
    missions.start()
    team.run(1.0)
    assert team.coordinator.tasks.find("m1.a").task.place == Point2D(5.0, 3.0)


def test_a_step_may_name_the_tasks_of_steps_before_it(team):
    noted = {"kind": "note", "place": [5.0, 3.0], "text": "after {a} of {mission}"}
    missions = MissionTeam(team, mission("round", step("a", repeats=1), step("b", noted)))
    missions.robot.plugins = ["explore", "visit", "note"]
    missions.start()
    team.run(1.0)
    missions.fail()
    missions.end()
    assert team.coordinator.tasks.find("m1.b").task.parameters == {"text": "after m1.a.2 of m1"}


def test_missions_are_bounded_and_the_last_of_each_name_is_remembered(team):
    missions = MissionTeam(team, mission("round", step("a", IN_WALL)), mission("tour", step("a")))
    missions.start(id="first")
    missions.start("tour", id="t0")
    team.run(0.5)
    missions.end()
    for number in range(KEPT_ENDED + 3):
        missions.start(id=f"n{number}")
        team.run(0.04)
    known = [one.id for one in team.ask(MISSION_LIST, None, list[MissionStatus])]
    assert known == ["t0", *(f"n{number}" for number in range(3, KEPT_ENDED + 3))]
    assert len(team.summary.missions) == 5
    missions.robot.accepts = False
    for number in range(OPEN_MAX):
        missions.start("tour", id=f"t{number + 1}")
    with pytest.raises(CallError, match=f"expected at most {OPEN_MAX} open missions"):
        missions.start("tour", id="more")


# -- restarts ---------------------------------------------------------------------------------------------------------


class Killed(BaseException):
    """The process ends here."""


class KilledConnection(sqlite3.Connection):
    """A journal's connection that fails at a chosen transaction, as if the process were killed before it."""

    remaining = 10**9
    error: BaseException = Killed()

    def execute(self, statement, *values):
        if statement == "BEGIN IMMEDIATE":
            KilledConnection.remaining -= 1
            if KilledConnection.remaining == -1:
                raise KilledConnection.error
        return super().execute(statement, *values)


ROUND = mission(
    "round",
    step("a", on_failure={"name": "rescue"}),
    step("b", TOO_LATE, after=[], on_failure="skip"),
    step("c", B, repeats=1),
)
RESCUE = mission("rescue", step("d", B))
FAILING = ("m1.a", "m1.c")


def run_with_kill(team, transaction) -> tuple[MissionTeam, bool]:
    """Run the mission to its end; before a transaction the coordinator is killed, and begins again."""
    KilledConnection.remaining = 10**9
    missions = MissionTeam(team, ROUND, RESCUE, journal=Journal(factory=KilledConnection))
    KilledConnection.remaining = transaction
    is_started = was_killed = False
    for _ in range(100):
        try:
            is_started = is_started or bool(missions.start())
            team.run(1.0)
            if missions.status().state.ended:
                break
        except (Killed, NobodyThere):
            was_killed = True
            KilledConnection.remaining = 10**9
            missions.restart()
        task = missions.robot.task
        if task is not None and not task.state.ended:
            missions.robot.end(TaskState.FAILED if task.id in FAILING else TaskState.DONE, "stuck")
    KilledConnection.remaining = 10**9
    return missions, was_killed


@pytest.mark.slow
@pytest.mark.parametrize("first", range(8))
def test_a_kill_before_any_transaction_neither_repeats_nor_loses_a_step(team, first):
    """Every eighth transaction is tried; together they are all."""
    for transaction in range(first, 1000, 8):
        team.begin(None)
        team.heard.clear()
        missions, was_killed = run_with_kill(team, transaction)
        assert missions.steps() == {"a": StepState.SKIPPED, "b": StepState.SKIPPED, "c": StepState.DONE}, transaction
        assert missions.status().state is MissionState.DONE
        done = dict.fromkeys(("m1.a.run.d", "m1.c.2"), TaskState.DONE)
        assert missions.tasks() == dict.fromkeys(FAILING, TaskState.FAILED) | done, transaction
        missions.robot.leave()
        team.robots.remove(missions.robot)
        if not was_killed:
            assert transaction > 20
            return
    pytest.fail("there are more transactions than were tried")


def test_a_mission_that_ended_unseen_has_no_open_tasks_after_a_restart(team):
    """The coordinator is killed between the end of the mission and that of its tasks."""
    KilledConnection.remaining = 10**9
    missions = MissionTeam(team, mission("round", step("a")), journal=Journal(factory=KilledConnection))
    missions.start()
    team.run(1.0)
    KilledConnection.remaining = 1
    missions.cancel()
    with pytest.raises(Killed):
        team.run(1.0)
    assert missions.tasks() == {"m1.a": TaskState.RUNNING}
    KilledConnection.remaining = 10**9
    missions.restart()
    team.run(1.0)
    assert missions.tasks() == {"m1.a": TaskState.CANCELLED}


def test_a_started_mission_does_not_change_with_the_file(team):
    missions = MissionTeam(team, mission("round", step("a"), step("b", B)))
    missions.start()
    team.run(1.0)
    missions.missions = (mission("tour", step("b")),)
    missions.restart()
    team.run(1.0)
    missions.end()
    assert missions.tasks() == {"m1.a": TaskState.DONE, "m1.b": TaskState.RUNNING}
    with pytest.raises(CallError, match="there is no mission round; known are tour"):
        missions.start(id="m2")


@pytest.mark.parametrize("transaction", range(4))
def test_a_step_waits_for_a_journal_that_cannot_be_written(team, transaction):
    """Of the end of the task, the end of the step, and the next task."""
    KilledConnection.remaining = 10**9
    missions = MissionTeam(team, mission("round", step("a"), step("b")), journal=Journal(factory=KilledConnection))
    missions.start()
    team.run(1.0)
    KilledConnection.error, KilledConnection.remaining = sqlite3.OperationalError("disk full"), 0
    with pytest.raises(CallError, match="disk full"):
        missions.start(id="m2")
    KilledConnection.remaining = 0
    with pytest.raises(CallError, match="mission m1 is not cancelled"):
        missions.cancel()
    KilledConnection.remaining = transaction
    missions.end()
    team.run(1.0)
    assert KilledConnection.remaining < -1
    KilledConnection.error, KilledConnection.remaining = Killed(), 10**9
    assert missions.tasks() == {"m1.a": TaskState.DONE, "m1.b": TaskState.RUNNING}
