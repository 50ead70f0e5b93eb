"""The coordinator keeps a field of motes alive by itself: the tasks that it makes and calls off, and what it tells."""

import msgspec
import pytest

from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.motes.mote_field import FieldKeeper
from robrain.coordinator.planning.policy import MoteFieldPolicy, PlanningPolicy
from robrain.protocol.messages.tasks.task_messages import TASK_EXPLAIN, TaskExplanation, TaskFilter, TaskRequest
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import TaskState
from tests.coordinator.motes.test_motes import Field
from tests.plain_reason import Plain

NEAR, FAR, WEST = Point2D(6.5, 4.0), Point2D(2.0, 2.0), Point2D(2.0, 6.0)
COLLECT = MoteFieldPolicy(collect_age_s=20.0)


@pytest.fixture
def field(team):
    found = Field(team)
    found.robot.plugins = ["collect", "replace", "relay"]
    return found


def keep(field, policy, **planning):
    field.team.coordinator.set_policy(PlanningPolicy(mote_field=policy, **planning))


def made(field, kind):
    records = field.team.coordinator.tasks.journal.select(TaskFilter())
    return [record for record in records if record.task.kind == kind]


def state(field):
    return field.team.coordinator.part(FieldKeeper).state


def test_nothing_is_done_and_told_unless_asked_for(field) -> None:
    mote = field.mote()
    field.run(5.0)
    mote.speaks = False
    field.run(60.0)
    assert field.team.coordinator.tasks.journal.select(TaskFilter()) == []
    assert field.team.summary.mote_field is msgspec.UNSET


def test_robot_is_sent_to_collect_when_a_mote_s_data_are_old_and_not_before(field) -> None:
    keep(field, COLLECT)
    mote = field.mote()
    field.run(5.0)
    mote.speaks = False
    field.run(14.0)
    assert made(field, "collect") == []
    field.run(8.0)
    (record,) = made(field, "collect")
    assert (record.by, record.robot, record.task.place) == ("mote field", "r1", NEAR)
    assert record.task.parameters["mote"] == "m1"
    why = field.team.ask(TASK_EXPLAIN, TaskRequest(id=record.task.id), TaskExplanation)
    assert why.changes[0].reason.code == "data_old"
    assert why.changes[0].reason.values["age_s"] >= 20.0
    assert why.changes[0].why == f"the newest reading of m1 is {why.changes[0].reason.values['age_s']:.0f} s old"


def test_motes_that_are_nearly_due_are_collected_on_the_same_tour_and_older_data_weigh_more(field) -> None:
    keep(field, COLLECT)
    field.robot.accepts = False
    first, second, third = field.mote("m1"), field.mote("m2", FAR), field.mote("m3", Point2D(3.0, 6.0))
    field.run(5.0)
    first.speaks = False
    field.run(5.0)
    second.speaks = False
    field.run(17.0)
    records = {record.task.parameters["mote"]: record for record in made(field, "collect")}
    assert sorted(records) == ["m1", "m2"]
    assert records["m1"].task.priority > records["m2"].task.priority
    assert third.speaks


def test_successor_of_a_coordinator_goes_on_with_its_tasks(field, tmp_path) -> None:
    team = field.team
    journal = Journal(tmp_path / "team.journal")
    team.begin(journal, PlanningPolicy(mote_field=COLLECT))
    field.robot.accepts = False
    mote = field.mote()
    field.run(5.0)
    mote.speaks = False
    field.run(25.0)
    assert len(made(field, "collect")) == 1
    team.begin(journal, PlanningPolicy(mote_field=COLLECT))
    mote.say(20.0, age_s=25.0)
    field.run(5.0)
    (record,) = made(field, "collect")
    assert record.state is TaskState.QUEUED
    mote.speaks = True
    field.run(3.0)
    assert made(field, "collect")[0].state is TaskState.CANCELLED
    journal.close()


def test_mote_at_which_robots_were_in_vain_is_dead_until_it_is_heard(field) -> None:
    keep(field, COLLECT)
    mote = field.mote()
    field.run(5.0)
    mote.speaks = False
    for _ in range(200):
        field.run(0.5)
        if field.robot.task is not None and field.robot.task.state is TaskState.RUNNING:
            field.robot.end(TaskState.FAILED, "nothing came")
        if state(field).dead:
            break
    assert (state(field).motes, state(field).dead) == (1, 1)
    assert state(field).first_dead_ns == state(field).last_dead_ns
    count = len(made(field, "collect"))
    field.run(60.0)
    assert len(made(field, "collect")) == count
    mote.speaks = True
    field.run(5.0)
    assert (state(field).dead, state(field).first_dead_ns) == (0, None)


def test_robot_stands_in_before_the_cells_are_empty(field) -> None:
    keep(field, MoteFieldPolicy(replacements=1, replace_before_s=30.0, replacement_s=50.0))
    mote = field.mote()
    for _ in range(20):
        mote.voltage_v -= 0.02  # 1 V takes 200 s: at 2.6 V there are 100 s left
        field.run(4.0)
    assert made(field, "replace") == []
    for _ in range(20):
        mote.voltage_v -= 0.02
        field.run(4.0)
    (record,) = made(field, "replace")
    assert record.task.parameters == {"mote": "m1", "duration_s": 50.0, "period_s": 4.0}
    assert field_reason(field, record).code == "mote_ends"
    assert 0.0 < field_reason(field, record).values["remaining_s"] <= 30.0


def field_reason(field, record):
    return field.team.ask(TASK_EXPLAIN, TaskRequest(id=record.task.id), TaskExplanation).changes[0].reason


def test_no_more_robots_stand_in_than_allowed_and_none_where_another_mote_tells_of_the_floor(field) -> None:
    keep(field, MoteFieldPolicy(replacements=1, sensing_m=1.0))
    field.robot.accepts = False
    dying = [field.mote(name, place, voltage_v=2.11) for name, place in (("m1", NEAR), ("m2", FAR), ("m4", WEST))]
    field.mote("m3", NEAR)
    field.run(5.0)
    for mote in dying:
        mote.speaks = False
    field.run(20.0)
    assert [record.task.parameters["mote"] for record in made(field, "replace")] == ["m2"]


def test_what_a_stand_in_tells_makes_the_data_younger_and_says_nothing_of_the_cells(field) -> None:
    keep(field, COLLECT)
    mote = field.mote(voltage_v=2.11)
    field.run(5.0)
    mote.speaks = False
    field.run(10.0)
    life = field.team.coordinator.part(FieldKeeper).ledger.motes["m1"]
    mote.voltage_v = 24.0
    mote.say(20.0, numbered=False)
    field.run(0.5)
    assert life.age_s(field.team.clock.now_ns()) < 1.0 < life.silent_s(field.team.clock.now_ns())
    assert life.latest.voltage_v == 2.11


def test_relay_is_sent_to_where_most_motes_are_heard_that_nobody_hears(field) -> None:
    keep(field, MoteFieldPolicy(relays=1, relay_reach_m=3.0, relay_s=40.0))
    field.robot.accepts = False
    motes = [field.mote("m1", NEAR), field.mote("m2", FAR), field.mote("m3", Point2D(3.0, 3.0))]
    field.run(5.0)
    for mote in motes:
        mote.speaks = False
    field.run(20.0)
    (record,) = made(field, "relay")
    assert record.task.parameters == {"mote": "m2", "duration_s": 40.0}
    assert field_reason(field, record) == Plain("mote_cut_off", mote="m2", others=1)


def test_as_few_motes_as_cover_the_floor_are_on_duty_and_the_others_rest(field) -> None:
    keep(field, MoteFieldPolicy(turns_s=40.0, rest_factor=5.0, sensing_m=2.0))
    motes = [field.mote("m1", NEAR, voltage_v=2.9), field.mote("m2", NEAR, voltage_v=2.6), field.mote("m3", FAR)]
    field.run(3.0)
    field.run(38.0)
    assert [mote.period_s for mote in motes] == [4.0, 20.0, 4.0]
    assert state(field).on_duty == 2
    motes[0].voltage_v = 2.4
    field.run(60.0)
    assert [mote.period_s for mote in motes] == [20.0, 4.0, 4.0]
    assert state(field).coverage == 1.0


def test_no_mote_rests_for_so_long_that_a_robot_would_be_sent_to_it(field) -> None:
    keep(field, MoteFieldPolicy(turns_s=20.0, rest_factor=20.0, collect_age_s=30.0))
    motes = [field.mote("m1", NEAR, voltage_v=2.9), field.mote("m2", NEAR, voltage_v=2.6)]
    field.run(90.0)
    assert [mote.period_s for mote in motes] == [4.0, 12.0]
    assert made(field, "collect") == []


def test_delivery_counts_what_was_taken_and_has_not_come(field) -> None:
    keep(field, COLLECT)
    mote = field.mote()
    field.run(40.0)
    assert state(field).delivery_ratio > 0.9
    mote.speaks = False
    field.run(40.0)
    assert 0.4 < state(field).delivery_ratio < 0.65
    assert state(field).oldest_s == pytest.approx(state(field).age_s) == pytest.approx(42.0, abs=3.0)
