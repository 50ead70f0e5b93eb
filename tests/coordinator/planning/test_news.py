"""What asks for another plan, and what is too little to."""

import msgspec
import pytest

from robrain.coordinator.planning.news import News
from robrain.coordinator.planning.situation import Member
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.task import TaskState, Visit
from robrain.protocol.wire.messages import BatteryState, RobotState
from robrain.protocol.wire.task_messages import TaskRecord
from tests.coordinator.planning.worlds import model

HOME = Point2D(0.0, 0.0)


def record(name="t1", state=TaskState.QUEUED, robot=""):
    return TaskRecord(task=Visit(id=name, place=HOME), state=state, robot=robot)


def member(name="r1", *, usable_j=10_000.0, j_per_m=20.0, soc=0.5, **fields):
    """50 kJ in a battery of 100 kJ; nothing but its ways takes energy."""
    energy = msgspec.structs.replace(model(usable_j), coefficients=(0.0, 0.0, j_per_m, 0.0, 0.0))
    battery = BatteryState(voltage_v=16.0, current_a=1.0, temperature_c=20.0, soc=soc, remaining_j=50_000.0)
    told = {"offers": frozenset({"visit"}), "chargers": (), "home": HOME, **fields}
    return Member(RobotState(robot=name, pose=Pose2D(0.0, 0.0, 0.0), energy=energy, battery=battery), **told)


def cause(before, now, *, left_out=0):
    """Why a team is planned for anew that was `before` and is `now`: records, members, pauses and area of each."""
    news = News()
    news.note(*team(**before))
    return news.since(*team(**now), left_out=left_out)


def team(records=None, members=None, pauses=(), area_m2=100.0):
    found = [member()] if members is None else members
    return [record()] if records is None else records, {one.state.robot: one for one in found}, pauses, area_m2


def test_a_team_that_is_as_it_was_is_no_news():
    assert cause({}, {}) == ""
    assert cause({"records": []}, {"records": [], "members": [member(usable_j=0.0)], "area_m2": 500.0}) == ""


def test_whether_there_were_tasks_is_known():
    news = News()
    assert not news.has_tasks
    news.note(*team())
    assert news.has_tasks


@pytest.mark.parametrize(
    ("now", "told"),
    [
        ([record(), record("t2")], "t2 is queued"),
        ([], "t1 has ended"),
        ([record(state=TaskState.RUNNING, robot="r1")], "t1 is running"),
        ([record(state=TaskState.LOST_CONTACT, robot="r1")], "t1 is lost contact"),
        ([record(f"t{k}") for k in range(1, 4)], "t2 is queued, t3 is queued"),
        ([record(f"t{k}") for k in range(1, 5)], "t2 is queued, t3 is queued, t4 is queued"),
        ([record(f"t{k}") for k in range(1, 6)], "t2 is queued, t3 is queued, t4 is queued and 1 more"),
        ([record(f"t{k}") for k in range(1, 7)], "t2 is queued, t3 is queued, t4 is queued and 2 more"),
    ],
)
def test_a_task_that_came_ended_or_changed_is_news(now, told):
    assert cause({}, {"records": now}) == told


def test_an_offer_that_is_taken_is_no_news():
    offered = record(state=TaskState.OFFERED, robot="r1")
    running = record(state=TaskState.RUNNING, robot="r1")
    assert cause({"records": [offered]}, {"records": [running]}) == ""


def test_a_task_that_begins_as_it_was_planned_is_no_news():
    news = News()
    news.note(*team())
    news.begun("t1", "r1")
    news.begun("t9", "r1")  # of which nothing is known
    running = team(records=[record(state=TaskState.RUNNING, robot="r1")])
    assert news.since(*running, left_out=0) == ""
    other = team(records=[record(state=TaskState.RUNNING, robot="r2")])
    assert news.since(*other, left_out=0) == "t1 is running"


def test_a_robot_that_comes_or_goes_is_news():
    assert cause({}, {"members": [member(), member("r3"), member("r2")]}) == "r2 is there; r3 is there"
    assert cause({"members": [member(), member("r2")]}, {"members": [member("r3")]}) == (
        "r3 is there; r1 is out; r2 is out"
    )


@pytest.mark.parametrize("fields", [{"offers": frozenset()}, {"chargers": (HOME,)}, {"free_ns": 1}])
def test_a_robot_that_can_do_other_things_is_news(fields):
    assert cause({}, {"members": [member(**fields)]}) == "r1 can do other things than before"
    assert cause({"members": [member(free_ns=5)]}, {"members": [member(free_ns=9)]}) == ""


def test_whom_a_task_may_be_offered_to_is_news():
    pair = ("t1", "r1")
    assert cause({}, {"pauses": [pair]}) == "whether r1 may be asked for t1"
    assert cause({"pauses": [pair]}, {}) == "whether r1 may be asked for t1"
    assert cause({"pauses": [pair]}, {"pauses": [pair]}) == ""


@pytest.mark.parametrize(
    ("usable_j", "is_news"), [(8_000.0, False), (7_999.0, True), (12_000.0, False), (12_001.0, True)]
)
def test_a_fiftieth_of_a_battery_more_or_less_than_planned_is_news(usable_j, is_news):
    told = cause({}, {"members": [member(usable_j=usable_j)]})
    assert told == (f"r1 has {usable_j:.0f} J left, and had 10000 J" if is_news else "")


def test_an_empty_battery_has_a_size_as_well():
    before, now = [member(soc=0.0, usable_j=100_000.0)], [member(soc=0.0, usable_j=0.0)]  # 0.02 of 50 kJ / 0.01
    assert cause({"members": before}, {"members": now}) == ""
    assert cause({"members": [member(soc=0.0, usable_j=100_001.0)]}, {"members": now}) != ""


@pytest.mark.parametrize(("j_per_m", "is_news"), [(21.0, False), (21.1, True), (19.0, False), (18.9, True)])
def test_ways_that_have_become_dearer_or_cheaper_by_a_twentieth_are_news(j_per_m, is_news):
    told = cause({}, {"members": [member(j_per_m=j_per_m)]})
    assert told == (f"r1 takes {j_per_m:.1f} J a metre, and took 20.0 J" if is_news else "")


def without_energy(battery):
    one = member()
    state = msgspec.structs.replace(one.state, energy=None, battery=one.state.battery if battery else None)
    return one._replace(state=state)


def test_a_robot_that_tells_nothing_of_its_energy_is_no_news():
    assert cause({"members": [without_energy(False)]}, {"members": [without_energy(False)]}) == ""
    assert "r1 has 10000 J left" in cause({"members": [without_energy(True)]}, {})


@pytest.mark.parametrize(
    ("before_m2", "now_m2", "left_out", "is_news"),
    [(100.0, 105.0, 1, False), (100.0, 105.5, 1, True), (100.0, 105.5, 0, False), (0.0, 1.0, 0, True),
     (0.0, 0.0, 1, False), (100.0, 50.0, 1, False)],
)  # fmt: skip
def test_a_map_that_has_grown_is_news_for_tasks_that_were_left_out(before_m2, now_m2, left_out, is_news):
    told = cause({"area_m2": before_m2}, {"area_m2": now_m2}, left_out=left_out)
    assert told == (f"the map has grown to {now_m2:.0f} m²" if is_news else "")
