"""Whatever robots, people and kills do, in whatever order: no task is lost, each ends, and each ends once."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.protocol.errors import CallError
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from tests.coordinator.histories import ROBOTS, TaskHistory, play

pytestmark = pytest.mark.slow

AFTER = {"a": (), "b": ("a",), "c": (), "d": ("b", "c"), "e": ("f",), "f": (), "g": ("h",), "h": ()}
"""What each task waits for; it may be asked for before those that it waits for."""
LONGEST_S = 400.0
"""From the last trouble to the end of all tasks: refusals pause for up to 60 s."""

robots = st.sampled_from(range(len(ROBOTS)))
names = st.sampled_from(sorted(AFTER))
ACTIONS = st.one_of(
    st.tuples(st.just("submit"), names, st.sampled_from([None, None, 2.0, 20.0])),
    st.tuples(st.just("run"), st.sampled_from([0.02, 0.1, 0.5, 1.2, 2.5])),
    st.tuples(st.just("run"), st.sampled_from([0.1, 0.5, 0.5, 2.5])),
    st.tuples(st.just("end"), robots, st.sampled_from([TaskState.DONE, TaskState.FAILED, TaskState.CANCELLED])),
    st.tuples(st.just("end"), robots, st.just(TaskState.DONE)),
    st.tuples(st.just("trouble"), robots, st.sampled_from(["speaks", "accepts", "answers", "halted"])),
    st.tuples(st.just("well"), robots),
    st.tuples(st.just("restart"), robots),
    st.tuples(st.just("kill")),
    st.tuples(st.just("cancel"), names),
)


class History(TaskHistory):
    """A coordinator and three robots in lockstep."""

    def __init__(self, session):
        super().__init__(session)
        for number, name in enumerate(ROBOTS):
            self.team.robot(name, 4.0 + 2.0 * number)
        self.team.closed_room()
        self.team.run(0.2)

    def submit(self, name, deadline_s):
        task = Task(id=name, kind="visit", place=Point2D(4.0 + 0.5 * sorted(AFTER).index(name), 4.0), after=AFTER[name])
        before = name in self.accepted
        try:
            self.team.submit(task, deadline_in_s=deadline_s)
        except CallError as error:  # another deadline than before, or it waits for a failed one
            reason = error.message
        else:
            reason = ""
            self.accepted.add(name)
        assert not reason or before or "wait" in reason
        return reason

    def run(self, duration_s):
        self.team.run(duration_s)

    def end(self, robot, state):
        one = self.team.robots[robot]
        if one.task is not None and not one.task.state.ended:
            one.end(state, "so it went")

    def trouble(self, robot, what):
        setattr(self.team.robots[robot], what, what == "halted")

    def well(self, robot):
        one = self.team.robots[robot]
        one.speaks = one.accepts = one.answers = True
        one.halted = False

    def restart(self, robot):
        one = self.team.robots[robot]
        one.task = None
        one.leave()
        one.come()

    def check(self):
        records = self.check_records()
        bound = [record.robot for record in records.values() if record.robot and not record.state.ended]
        assert len(bound) == len(set(bound))

    def finish(self):
        """All robots are well again, and do what they are told: every task comes to an end."""
        for robot in range(len(ROBOTS)):
            self.well(robot)
        for _ in range(round(LONGEST_S / 0.5)):
            states = self.team.states()
            if all(state.ended for state in states.values()):
                break
            self.team.run(0.5)
            for robot in range(len(ROBOTS)):
                self.end(robot, TaskState.DONE)
            waited_for = {name for record in self.journal.open_records() for name in record.task.after}
            for name in sorted(waited_for - set(states)):  # it must be asked for some day
                if self.submit(name, None):  # what it waits for has failed: people take back what waits for it
                    for waiting in sorted(one for one in AFTER if name in AFTER[one]):
                        self.cancel(waiting)
        assert {name: state for name, state in self.team.states().items() if not state.ended} == {}
        self.check()


@settings(max_examples=15, deadline=None)
@given(actions=st.lists(ACTIONS, min_size=30, max_size=120))
def test_no_task_is_lost_and_each_ends_once_whatever_happens(actions):
    play(History, actions)
