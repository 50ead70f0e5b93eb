"""Motes as members of the team: what they do in place of robots, and what becomes of it when they fall silent."""

from types import SimpleNamespace

import pytest

from robrain.algorithms.motes.mote_energy import CAPACITY_J, FLAT_V, FRESH_V
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.motes.mote_members import (
    MoteMembers,
    MoteTable,
    mote_remaining_j,
    mote_share,
    reading_j,
    robot_cost,
)
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.clock import to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.motes.mote_messages import MOTE_DUTY, MOTE_READING, MoteReading
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.task_messages import (
    TASK_CANCEL,
    TASK_EXPLAIN,
    TASK_GET,
    TaskExplanation,
    TaskRequest,
)
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task, TaskState
from tests.coordinator.conftest import TICK_S
from tests.energy_models import energy_model
from tests.plain_reason import Plain

PLACE = Point2D(6.5, 4.0)
MODEL = energy_model(
    8.0, 0.5, 7.5, 1.25, 8.0, turn_rate_rad_s=1.2, packet_j=0.0008, usable_j=6e4, power_w=12.0, usual_power_w=11.0
)


class Mote:
    """A mote as the wire knows it; r1 brings its readings in."""

    def __init__(self, team, name="m1", place=PLACE, *, period_s=4.0, voltage_v=3.0, quantity="temperature_c"):
        wire = team.endpoint()
        self._readings = wire.publisher(MOTE_READING, mote=name)
        self.duties = Inbox(every=True)
        wire.subscribe(self.duties, MOTE_DUTY, mote=name)
        self.team, self.name, self.place, self.voltage_v, self.quantity = team, name, place, voltage_v, quantity
        self.period_s = period_s
        self.speaks = True
        self._sequence = 0
        self._due_s = 0.0

    def step(self, now_s):
        for received in self.duties.drain():
            self.period_s = received.message.period_s
        if self.speaks and now_s >= self._due_s:
            self._due_s = now_s + self.period_s
            self.say(20.0 + 0.5 * self._sequence)

    def say(self, value, *, age_s=0.0, numbered=True):
        self._sequence += 1
        self._readings.put(
            MoteReading(
                mote=self.name,
                place=self.place,
                quantity=self.quantity,
                value=value,
                voltage_v=self.voltage_v,
                rssi_dbm=-60.0,
                via="r1",
                sequence=self._sequence if numbered else None,
                measured_ns=self.team.clock.now_ns() - to_ns(age_s),
                period_s=self.period_s,
            )
        )


class Field:
    """A team of one robot that can sense, and some motes."""

    def __init__(self, team):
        self.team, self.motes = team, []
        self.robot = team.robot("r1", 4.5, 3.0)
        self.robot.plugins = ["explore", "sense", "monitor"]
        self.robot.energy = MODEL
        team.closed_room()

    def mote(self, *args, **fields):
        self.motes.append(Mote(self.team, *args, **fields))
        return self.motes[-1]

    def run(self, seconds):
        for _ in range(round(seconds / 0.1)):
            for mote in self.motes:
                mote.step(self.team.clock.now_ns() / 1e9)
            self.team.run(0.1)

    def monitor(self, duration_s):
        parameters = {"duration_s": duration_s, "interval_s": 1.0, "quantity": "temperature_c"}
        self.team.submit(Task(id="w", kind="monitor", place=PLACE, parameters=parameters))

    def get(self, task_id):
        return self.team.ask(TASK_GET, TaskRequest(id=task_id))

    def verdicts(self, task_id):
        return {one.robot: one for one in self.team.ask(TASK_EXPLAIN, TaskRequest(id=task_id), TaskExplanation).robots}


@pytest.fixture
def field(team):
    return Field(team)


def test_mote_that_is_at_the_place_senses_and_no_robot_drives(field):
    field.mote()
    field.run(2.0)
    field.team.submit(Task(id="s", kind="sense", place=PLACE))
    field.run(5.0)
    record = field.get("s")
    assert (record.state, record.robot) == (TaskState.DONE, "mote:m1")
    assert record.result["mote"] == "m1"
    assert record.result["value"] == 20.5  # the reading after the task, not the one before
    assert field.robot.offers == [] or all(offer.task.id != "s" for offer in field.robot.offers)


def test_a_verdict_of_each_member_says_what_share_of_its_energy_it_would_take(field):
    field.mote()
    field.mote("m2", Point2D(4.0, 3.0))
    field.run(2.0)
    field.team.submit(Task(id="s", kind="sense", place=PLACE))
    field.run(0.1)
    verdicts = field.verdicts("s")
    assert verdicts["m1"].chosen
    assert verdicts["m2"].refusal == "is 2.7 m from the place"
    assert not verdicts["r1"].chosen
    assert verdicts["r1"].energy_j > 1000 * verdicts["m1"].energy_j


@pytest.mark.parametrize(
    ("voltage_v", "silent_s", "kind", "parameters", "robot"),
    [
        (3.0, 0.0, "sense", {"mote": "m1"}, "mote:m1"),  # the one that is named, wherever it is
        (FLAT_V + 1e-7, 0.0, "sense", {"mote": "m1"}, "r1"),
        (3.0, 20.0, "sense", {"mote": "m1"}, "r1"),
        (3.0, 0.0, "monitor", {"duration_s": 20.0}, "r1"),  # with pictures
    ],
)
def test_a_robot_does_what_no_mote_can(field, voltage_v, silent_s, kind, parameters, robot):
    mote = field.mote("m1", Point2D(4.0, 3.0), voltage_v=voltage_v)
    field.run(2.0)
    mote.speaks = not silent_s
    field.run(silent_s)
    field.team.submit(Task(id="t", kind=kind, place=PLACE, parameters=parameters))
    field.run(2.0)
    assert field.get("t").robot == robot


def test_task_that_a_mote_gave_up_is_offered_to_a_robot_in_the_same_step(field):
    team = field.team
    team.begin(None, PlanningPolicy(method="nearest"))  # no plan is made for it
    mote = field.mote()
    field.run(5.0)
    mote.speaks = False
    team.submit(Task(id="s", kind="sense", place=PLACE, parameters={"timeout_s": 10.0}))
    field.run(1.0)
    assert field.get("s").robot == "mote:m1"
    for _ in range(round(14.0 / TICK_S)):
        if field.get("s").robot == "mote:m1":
            team.run(TICK_S)
    freed, offered = (event.stamp_ns for event in team.heard[-3:-1])
    assert [event.state for event in team.heard[-3:]] == [TaskState.QUEUED, TaskState.OFFERED, TaskState.RUNNING]
    assert freed == offered


@pytest.mark.parametrize(
    ("task", "why"),
    [
        (
            Task(id="s", kind="sense", place=PLACE, parameters={"quantity": "light_lx"}),
            "senses temperature_c, not light_lx",
        ),
        (Task(id="s", kind="sense", place=Point2D(4.0, 2.5)), "m from the place"),
        (Task(id="s", kind="sense", place=PLACE, needs=("sensor_board",)), "has no sensor_board"),
        (
            Task(id="s", kind="sense", place=PLACE, parameters={"timeout_s": 2.0}),
            "speaks each 4 s, and 2 s is all that is waited",
        ),
    ],
)
def test_what_a_mote_cannot_do_it_is_not_asked_for(field, task, why):
    field.mote()
    field.run(2.0)
    field.robot.plugins.append("sensor_board")
    field.run(11.0)
    field.team.submit(task)
    field.run(0.2)
    record = field.get("s")
    verdicts, mote = field.team.coordinator.part(MoteMembers).judge(record, field.team.clock.now_ns())
    assert mote is None
    assert why in next(one.refusal for one in verdicts if one.robot == "m1")


@pytest.mark.parametrize(("period_s", "silent_s"), [(1.0, 5.0), (8.0, 24.0), (None, 12.0)])
def test_a_mote_is_out_of_reach_after_three_of_its_periods_but_not_within_five_seconds(period_s, silent_s):
    reading = MoteReading(
        mote="m1", place=PLACE, quantity="t", value=1.0, voltage_v=3.0, rssi_dbm=0, via="gateway", period_s=period_s
    )
    roster, table = SimpleNamespace(robots={}), MoteTable()
    table.record(reading, to_ns(1.0))
    mote = table.motes["m1"]
    assert mote.out_of_reach_reason(roster, to_ns(1.0 + silent_s)) is None
    reason = mote.out_of_reach_reason(roster, to_ns(1.1 + silent_s))
    assert reason == Plain("mote_silent", silent_s=silent_s + 0.1)


def test_mote_monitors_at_the_interval_asked_for_and_has_its_own_back_after(field):
    mote = field.mote()
    field.run(2.0)
    field.monitor(20.0)
    field.run(10.0)
    assert mote.period_s == 1.0
    field.run(16.0)
    record = field.get("w")
    assert (record.state, record.robot) == (TaskState.DONE, "mote:m1")
    assert 15 <= record.result["rounds"] <= 22
    assert record.result["least"] < record.result["greatest"]
    assert mote.period_s == 4.0


def test_monitoring_that_is_called_off_leaves_the_mote_as_it_was(field):
    mote = field.mote()
    field.run(2.0)
    field.monitor(60.0)
    field.run(8.0)
    field.team.ask(TASK_CANCEL, TaskRequest(id="w"))
    field.run(6.0)
    assert mote.period_s == 4.0
    assert field.get("w").state is TaskState.CANCELLED


def test_mote_s_task_does_not_outlive_its_deadline(field):
    mote = field.mote()
    field.run(5.0)
    mote.speaks = False
    field.team.submit(Task(id="s", kind="sense", place=PLACE), deadline_in_s=3.0)
    field.run(5.0)
    record = field.get("s")
    assert (record.state, record.why) == (TaskState.FAILED, "its deadline has passed")


def test_a_mote_with_a_clock_far_ahead_is_heard_like_others():
    table = MoteTable()
    fields = {"mote": "m1", "place": PLACE, "quantity": "t", "voltage_v": 3.0, "rssi_dbm": 0, "via": "r1"}
    for second in range(5):
        ahead_ns = 10**18 if second == 0 else 0
        table.record(
            MoteReading(value=float(second), stamp_ns=to_ns(second), measured_ns=to_ns(second) + ahead_ns, **fields),
            to_ns(second),
        )
    assert table.motes["m1"].latest.value == 4.0
    assert table.motes["m1"].received_ns == to_ns(4.0)


def test_coordinator_that_begins_anew_asks_again_for_what_a_mote_was_at(field, tmp_path):
    journal = Journal(tmp_path / "t.journal")
    field.team.begin(journal)
    mote = field.mote()
    field.run(2.0)
    field.monitor(6.0)
    field.run(2.0)
    journal.close()
    journal = Journal(tmp_path / "t.journal")
    field.team.begin(journal)
    field.run(1.0)
    assert field.get("w").state in (TaskState.QUEUED, TaskState.RUNNING)
    field.run(30.0)
    record = field.get("w")
    assert record.state is TaskState.DONE or record.robot == "r1"
    assert mote.speaks
    journal.close()


def test_stored_reading_from_before_the_task_does_not_count(field):
    mote = field.mote(period_s=8.0)
    field.run(0.5)
    field.team.submit(Task(id="s", kind="sense", place=PLACE))
    field.run(1.0)
    mote.say(99.0, age_s=5.0)
    field.run(1.0)
    assert field.get("s").state is TaskState.RUNNING
    field.run(8.0)
    assert field.get("s").result["value"] != 99.0


def test_share_is_of_what_a_member_has_left():
    assert mote_remaining_j(FRESH_V) == CAPACITY_J
    assert mote_remaining_j(0.5 * (FRESH_V + FLAT_V)) == pytest.approx(0.5 * CAPACITY_J)
    assert mote_remaining_j(1.0) > 0
    assert mote_share(10, 2.6) == pytest.approx(10 * reading_j() / (0.5 * CAPACITY_J))
    state = RobotState(robot="r1", pose=Pose2D(0.0, 0.0, 0.0), energy=MODEL)
    assert robot_cost(state, Point2D(0.0, 0.0), 10.0) == (pytest.approx(10.0 * 8.0 / 60_000.0), 80.0)
    assert robot_cost(RobotState(robot="r1"), PLACE, 1.0) == (float("inf"), None)
