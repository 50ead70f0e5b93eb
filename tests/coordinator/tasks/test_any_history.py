"""Whatever happens, whichever side is killed: no task is lost, in two robots or done twice, and each ends."""

from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.tasks.task_book import LEGAL
from robrain.protocol.errors import CallError
from robrain.protocol.messages.tasks.task_messages import (
    TASK_CANCEL,
    TASK_CHANGE,
    TaskFilter,
    TaskRecord,
    TaskRequest,
    TaskUpdate,
)
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.wire.session import open_lockstep_session
from tests.coordinator.conftest import Team
from tests.coordinator.desk_robots import DeskRobot

pytestmark = pytest.mark.slow

ROBOTS = ("r1", "r2", "r3")
TASKS = [f"t{number}" for number in range(8)]
AFTER = {"t1": ("t0",), "t3": ("t1", "t2"), "t4": ("t5",)}
"""What tasks wait for; those of which one of these was not submitted before are refused."""
SAME_ROBOT = {"t6": "t5", "t7": "t0"}
"""Tasks that the robot of another one has to do."""
TROUBLE = ["isolated", "stopped", "halted"]
LONGEST_S = 400.0
STEP_S = 0.1

CHANGES = st.sampled_from(
    [
        {"paused": True},
        {"paused": False},
        {"priority": 5.0},
        {"deadline_in_s": 30.0},
        *({field: name} for field in ("robot", "excluded") for name in ROBOTS),
    ]
)
robots = st.sampled_from(range(len(ROBOTS)))
ACTIONS = st.one_of(
    st.tuples(st.just("submit"), st.sampled_from(TASKS), st.none()),
    st.tuples(st.just("submit"), st.sampled_from(TASKS), st.sampled_from([None, 2.0, 20.0])),
    st.tuples(st.just("run"), st.sampled_from([0.1, 0.5, 1.0, 2.5])),
    st.tuples(st.just("run"), st.sampled_from([0.1, 0.5, 1.0, 4.0])),
    st.tuples(st.just("slows"), robots, st.sampled_from([0.3, 2.0, 5.0])),
    st.tuples(st.just("trouble"), robots, st.sampled_from(TROUBLE)),
    st.tuples(st.just("while_one_is_held"), st.sampled_from(TROUBLE), st.sampled_from([0.3, 1.8, 3.0, 6.0])),
    st.tuples(st.just("deaf"), robots),
    st.tuples(st.just("well"), robots),
    st.tuples(st.just("fails"), robots, st.sampled_from([TaskState.DONE, TaskState.FAILED])),
    st.tuples(st.just("refuses"), robots, st.sampled_from(TASKS)),
    st.tuples(st.just("restart"), robots),
    st.tuples(st.just("kill")),
    st.tuples(st.just("cancel"), st.sampled_from(TASKS)),
    st.tuples(st.just("change"), st.sampled_from(TASKS), CHANGES, st.booleans()),
)


class History:
    """A coordinator on a journal, and three robots, in lockstep."""

    def __init__(self, session):
        self.team = Team(session)
        self.journal = Journal()
        self.team.begin(self.journal)
        self.accepted = set()
        self.robots = [DeskRobot(self.team, name, 4.0 + 2.0 * number) for number, name in enumerate(ROBOTS)]
        self.team.closed_room()
        self.run(0.3)

    def kill(self):
        self.team.begin(self.journal)

    def cancel(self, name):
        with suppress(CallError):
            self.team.ask(TASK_CANCEL, TaskRequest(id=name))

    def change(self, name, fields, is_killed):
        """A task is changed; the coordinator may be killed before it has told the robots."""
        with suppress(CallError):
            self.team.ask(TASK_CHANGE, TaskUpdate(ids=[name], **fields), list[TaskRecord])
        if is_killed:
            self.kill()

    def submit(self, name, deadline_s):
        place, other = Point2D(4.0 + 0.5 * TASKS.index(name), 4.0), SAME_ROBOT.get(name, "")
        task = Task(id=name, kind="visit", place=place, after=AFTER.get(name, ()), same_robot_as=other)
        try:
            self.team.submit(task, deadline_in_s=deadline_s)
        except CallError as error:  # another deadline than before, or it waits for one that failed or is not there
            reason = error.message
        else:
            reason = ""
            self.accepted.add(name)
        assert not reason or name in self.accepted or "wait" in reason

    def run(self, duration_s):
        for _ in range(round(duration_s / STEP_S)):
            self.team.run(STEP_S)
            self.check_robots()

    def slows(self, robot, duration_s):
        self.robots[robot].takes_s = duration_s

    def trouble(self, robot, what):
        setattr(self.robots[robot], what, True)

    def while_one_is_held(self, what, duration_s):
        """Trouble comes to a robot that holds a task, and goes after a while."""
        for _ in range(50):
            holds = [number for number, one in enumerate(self.robots) if one.next and not one.stopped]
            if holds:
                self.trouble(holds[0], what)
                self.run(duration_s)
                self.well(holds[0])
                return
            self.run(STEP_S)

    def deaf(self, robot):
        """Offers reach it, and its answers nobody."""
        self.robots[robot].answers = False

    def well(self, robot):
        one = self.robots[robot]
        one.resume()
        one.isolated = one.halted = False
        one.answers = True
        one.refuses = set()
        one.ends_as = TaskState.DONE

    def fails(self, robot, state):
        self.robots[robot].ends_as = state

    def refuses(self, robot, task):
        self.robots[robot].refuses.add(task)

    def restart(self, robot):
        self.robots[robot].restart()

    def check_robots(self):
        """No task runs in two robots, and none is done twice, but where nobody could hear that it was done."""
        there = [one for one in self.robots if not one.stopped and one.is_settled]
        running = [one.running for one in there if one.running in self.accepted]
        assert len(running) == len(set(running)), {one.name: one.running for one in there}
        unheard = {task for one in self.robots for task in one.done_unheard}
        done = [task for one in self.robots for task in one.done if task in self.accepted - unheard]
        assert len(done) == len(set(done)), {one.name: one.done for one in self.robots}

    def check(self):
        records = {record.task.id: record for record in self.journal.select(TaskFilter())}
        assert set(records) == self.accepted
        for name, record in records.items():
            before = None
            for line in self.journal.history(name, 10_000):
                assert line.state in LEGAL[before]
                before = line.state
            assert before is record.state
        for robot in ROBOTS:
            bound = sorted(
                (one.epoch, one.state) for one in records.values() if one.robot == robot and not one.state.ended
            )
            assert len(bound) <= 2
            assert all(state is TaskState.OFFERED for _, state in bound[1:]), bound

    def finish(self):
        """All robots are well again and obey, and no task is paused: every task comes to an end."""
        open_tasks = TaskUpdate(which=TaskFilter(), paused=False)
        self.team.ask(TASK_CHANGE, open_tasks, list[TaskRecord])
        for robot in range(len(ROBOTS)):
            self.well(robot)
            self.slows(robot, 2.0)
        for _ in range(round(LONGEST_S / 1.0)):
            if all(state.ended for state in self.team.states().values()):
                break
            self.run(1.0)
        assert {name: state for name, state in self.team.states().items() if not state.ended} == {}
        self.check()
        done = {task for one in self.robots for task in one.done}
        assert {name for name, state in self.team.states().items() if state is TaskState.DONE} <= done


@settings(max_examples=15, deadline=None)
@given(actions=st.lists(ACTIONS, min_size=20, max_size=100))
def test_no_task_is_lost_or_done_twice_and_each_ends(actions):
    with open_lockstep_session() as session:
        history = History(session)
        try:
            for do, *arguments in actions:
                getattr(history, do)(*arguments)
                history.check()
            history.finish()
        finally:
            history.team.close()
