"""The coordinator keeps the team's zones, and refuses tasks that they make impossible."""

from contextlib import closing

import msgspec
import pytest

from robrain.algorithms.exploration.strategies import NO_EXPLORATION
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.clock import to_ns
from robrain.protocol.errors import CallError
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.tasks.task_messages import TASK_SUBMIT, TaskSubmission
from robrain.protocol.messages.team.door_messages import DOOR_STATE, DoorPosition, DoorState
from robrain.protocol.messages.team.zone_messages import (
    COORDINATOR_ZONES,
    COORDINATOR_ZONES_CHANGE,
    ZoneChange,
    Zones,
    ZoneTurn,
)
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.model.zone import ZONES_MAX, Zone, ZoneKind, ZoneTable, ZoneTimes
from robrain.protocol.reasons import ZoneShut


def box(name, x0, y0, x1, y1, kind=ZoneKind.KEEP_OUT, **fields):
    return Zone(name=name, kind=kind, corners_m=((x0, y0), (x1, y0), (x1, y1), (x0, y1)), **fields)


CORNER = box("corner", 3.0, 3.0, 4.5, 4.5)
MIDDLE = box("middle", 6.0, 0.0, 7.0, 20.0)
FILE = box("file", 0.0, 0.0, 1.0, 1.0)


def table(zone):
    return ZoneTable(**msgspec.structs.asdict(zone))


def change(team, *put, remove=()):
    return team.ask(COORDINATOR_ZONES_CHANGE, ZoneChange(put=[*put], remove=[*remove]), Zones).zones


def clear(team, *names, for_s=None, opens=()):
    return team.ask(COORDINATOR_ZONES_CHANGE, ZoneChange(clear=[*names], clear_s=for_s, open=[*opens]), Zones).zones


def refusal(team, x_m, y_m):
    with pytest.raises(CallError) as refused:
        team.ask(TASK_SUBMIT, task(x_m, y_m))
    return str(refused.value)


def task(x_m, y_m):
    return TaskSubmission(task=Task(id=f"t{x_m}-{y_m}", kind="visit", place=Point2D(x_m, y_m)))


def reason(team, task_id):
    return team.coordinator.tasks.find(task_id).reason


def stored(journal):
    return journal.part_states["ZoneKeeper"]["zones"]


def test_zones_are_added_replaced_and_removed(team):
    team.begin(None, PlanningPolicy(zones=(table(CORNER),)))
    assert change(team) == [CORNER]
    other = box("corner", 3.0, 3.0, 5.0, 5.0)
    assert change(team, other, MIDDLE) == [other, MIDDLE]
    assert change(team, remove=["corner"]) == [MIDDLE]
    with pytest.raises(CallError, match="there is no zone corner; known are middle"):
        change(team, remove=["corner"])
    with pytest.raises(CallError, match=f"at most {ZONES_MAX} zones"):
        change(team, *(box(f"z{number}", 0.0, 0.0, 1.0, 1.0) for number in range(ZONES_MAX)))
    with pytest.raises(CallError, match="got middle twice"):
        change(team, MIDDLE, MIDDLE)
    many = ((1.0, 0.0), *((0.0, 0.01 * number) for number in range(4095)))
    with pytest.raises(CallError, match="at most 16384 corners of all zones together, got 20480"):
        change(team, *(msgspec.structs.replace(CORNER, name=f"z{number}", corners_m=many) for number in range(5)))
    assert change(team) == [MIDDLE]


def test_changes_of_zones_survive_a_restart_and_a_copy_of_the_journal(team, tmp_path):
    path, planning = tmp_path / "journal.db", PlanningPolicy(zones=(table(CORNER), table(FILE)))
    with closing(Journal(path)) as journal:
        team.begin(journal, planning)
        change(team, MIDDLE, remove=["corner"])
        copy = Journal(None)
        copy.begin_copy()
        copy.put_page(journal.page(0, 10, term=1, seq=1))
        assert [*stored(copy)] == ["corner", "middle"]
        assert stored(copy)["corner"] is None
        changes = []
        journal.on_written = changes.append
        change(team, CORNER)
        copy.follow(changes)
        assert stored(copy)["corner"]["name"] == "corner"
        change(team, remove=["corner"])
    with closing(Journal(path)) as journal:
        team.begin(journal, planning)
        assert [zone.name for zone in change(team)] == ["file", "middle"]


def test_zones_are_published_after_a_change_and_every_two_seconds(team):
    team.begin(None)
    inbox = Inbox()
    team.asker.subscribe(inbox, COORDINATOR_ZONES)
    team.run(5.0)
    assert not inbox.has_some
    change(team, CORNER)
    for duration_s in (0.2, 2.0, 2.0):
        team.run(duration_s)
        assert [received.message.zones for received in inbox.drain()] == [[CORNER]]
    change(team, remove=["corner"])
    team.run(0.2)
    assert [received.message.zones for received in inbox.drain()] == [[]]


def test_a_place_in_or_behind_a_keep_out_zone_is_refused_with_its_name(team):
    team.begin(None)
    team.settle("r1", 8.5, 4.0)
    team.closed_room()
    team.run(1.0)
    change(team, CORNER, box("slow", 0.0, 0.0, 20.0, 20.0, ZoneKind.SPEED_LIMIT, speed_m_s=0.1))
    assert refusal(team, 4.0, 4.0).endswith("(4, 4) is in the keep-out zone corner")
    team.ask(TASK_SUBMIT, task(5.4, 5.4))
    change(team, MIDDLE)
    assert refusal(team, 5.0, 5.2).endswith("the keep-out zone middle separates (5, 5.2) from all robots")
    team.ask(TASK_SUBMIT, task(8.0, 5.0))
    change(team, remove=["middle", "corner"])
    team.ask(TASK_SUBMIT, task(5.0, 5.2))


def test_a_door_that_has_failed_or_is_silent_is_shut_until_it_reports_again(team):
    team.begin(None, PlanningPolicy(zones=(table(box("gate", 3.0, 3.0, 4.0, 4.0, ZoneKind.DOOR)),)))
    doors = team.asker.publisher(DOOR_STATE, door="gate")

    def is_shut(seconds, position=None):
        for _ in range(round(seconds)):
            if position is not None:
                doors.put(DoorState(door="gate", position=position))
            team.run(1.0)
        [zone] = change(team)
        return zone.is_shut

    assert not is_shut(9.0)
    assert is_shut(2.0)
    assert not is_shut(1.0, DoorPosition.CLOSED)
    assert is_shut(1.0, DoorPosition.FAILED)
    assert not is_shut(20.0, DoorPosition.OPEN)
    assert is_shut(12.0)


EACH_MINUTE = ZoneTimes(rrule="FREQ=MINUTELY", duration_s=20.0)


def published(team, inbox):
    """The names of the zones that hold and of the others, and the next changes in seconds, as last published."""
    *_, last = inbox.drain()
    zones = last.message
    assert all(zone.times is None for zone in zones.all)
    turns_s = {turn.zone: turn.at_ns / 1e9 for turn in zones.turns}
    return [zone.name for zone in zones.zones], [zone.name for zone in zones.off], turns_s


def test_a_zone_with_times_holds_only_then(team):
    """The team's clock begins at 0, on a full minute."""
    school = msgspec.structs.replace(CORNER, times=EACH_MINUTE)
    team.begin(None, PlanningPolicy(zones=(table(school), table(MIDDLE)), exploration=NO_EXPLORATION))
    robot = team.settle("r1", 5.3, 5.0)
    inbox = Inbox()
    team.asker.subscribe(inbox, COORDINATOR_ZONES)
    team.run(3.0)
    assert published(team, inbox) == (["corner", "middle"], [], {"corner": 20.0})
    assert team.ask(TASK_SUBMIT, task(4.0, 4.1)).state is TaskState.QUEUED
    team.run(4.0)
    assert reason(team, "t4.0-4.1") == ZoneShut("corner")
    assert not robot.offers
    team.run(14.0)
    assert published(team, inbox) == (["middle"], ["corner"], {"corner": 60.0})
    assert [offer.task.id for offer in robot.offers] == ["t4.0-4.1"]
    answer = team.ask(COORDINATOR_ZONES_CHANGE, ZoneChange(), Zones)
    assert (answer.zones, answer.off) == ([MIDDLE], [school])
    assert answer.turn_text(school).startswith("from 1970-01-0")
    assert answer.turn_text(MIDDLE) == ""
    change(team, remove=["middle"])
    team.ask(TASK_SUBMIT, task(4.0, 4.0))
    team.run(40.0)
    assert published(team, inbox) == (["corner"], [], {"corner": 80.0})


def test_a_zone_that_began_before_the_coordinator_holds(team):
    team.run(0.0)
    team.clock.advance_to(to_ns(25 * 3600.0))
    nightly = ZoneTimes(rrule="FREQ=DAILY;BYHOUR=23;BYMINUTE=0;BYSECOND=0", duration_s=4 * 3600.0)
    team.begin(None, PlanningPolicy(zones=(table(msgspec.structs.replace(CORNER, times=nightly)),)))
    answer = team.ask(COORDINATOR_ZONES_CHANGE, ZoneChange(), Zones)
    assert ([zone.name for zone in answer.zones], answer.turns) == (
        ["corner"],
        [ZoneTurn("corner", to_ns(27 * 3600.0))],
    )


def test_times_that_are_no_rule_are_refused():
    with pytest.raises(ValueError, match="expected rrule with FREQ"):
        ZoneTimes(rrule="FREQ=SECONDLY", duration_s=20.0)


def test_a_zone_for_a_type_of_robot_names_the_robots_that_have_its_plugin(team):
    fork = msgspec.structs.replace(MIDDLE, robots=("fork", "r3"))
    team.begin(None, PlanningPolicy(zones=(table(fork),)))
    inbox = Inbox()
    team.asker.subscribe(inbox, COORDINATOR_ZONES)
    lifter = team.settle("r1", 8.5, 4.0)
    team.robot("r2", 5.0, 5.0)
    lifter.plugins = ["explore", "visit", "fork"]
    team.run(12.0)
    *_, last = inbox.drain()
    assert [zone.robots for zone in last.message.zones] == [("fork", "r3", "r1")]
    assert [last.message.zones[0].binds(robot) for robot in ("r1", "r2", "r3")] == [True, False, True]
    assert change(team) == [fork]


def test_a_task_in_a_zone_without_stopping_is_refused_with_its_name(team):
    team.begin(None)
    team.settle("r1", 8.5, 4.0)
    change(team, box("quick", 3.0, 3.0, 4.5, 4.5, ZoneKind.NO_STOPPING))
    assert refusal(team, 4.0, 4.0).endswith("(4, 4) is in the no-stopping zone quick")
    change(team, box("quick", 3.0, 3.0, 4.5, 4.5, ZoneKind.NO_STOPPING, robots=("r2",)))
    team.ask(TASK_SUBMIT, task(4.0, 4.0))


def test_a_cleared_zone_recalls_its_tasks_holds_those_behind_it_back_and_opens(team):
    """The robot stands east of the middle. One task lies in the aisle, one west of the middle, one beside the robot."""
    aisle = box("aisle", 7.5, 2.0, 8.0, 4.5, ZoneKind.PLACE, robots=("r2",))
    zones = table(aisle), table(box("middle", 6.0, 0.0, 7.0, 20.0, ZoneKind.PLACE))
    team.begin(None, PlanningPolicy(zones=zones, give_up_s=5.0, exploration=NO_EXPLORATION))
    robot = team.settle("r1", 8.5, 4.0)
    inbox = Inbox()
    team.asker.subscribe(inbox, COORDINATOR_ZONES)
    team.ask(TASK_SUBMIT, task(7.8, 4.0))
    team.run(4.0)
    assert robot.task.state is TaskState.RUNNING
    clear(team, "aisle", "middle")
    team.run(3.0)
    assert robot.task.state is TaskState.CANCELLED
    *_, last = inbox.drain()
    assert [(zone.name, zone.is_shut, zone.robots) for zone in last.message.zones] == [
        ("aisle", True, ()),
        ("middle", True, ()),
    ]
    for x_m, y_m in ((5.0, 3.0), (8.6, 5.0)):
        team.ask(TASK_SUBMIT, task(x_m, y_m))
    team.run(5.0)
    robot.end(TaskState.DONE)
    team.run(10.0)
    assert team.states() == {"t7.8-4.0": TaskState.QUEUED, "t5.0-3.0": TaskState.QUEUED, "t8.6-5.0": TaskState.DONE}
    assert (reason(team, "t7.8-4.0"), reason(team, "t5.0-3.0")) == (ZoneShut("aisle"), ZoneShut("middle"))
    clear(team, opens=["aisle", "middle"])
    for _ in range(2):
        team.run(5.0)
        robot.end(TaskState.DONE)
    team.run(1.0)
    assert set(team.states().values()) == {TaskState.DONE}
    assert team.coordinator.tasks.find("t7.8-4.0").attempts == 0


def test_a_zone_is_cleared_for_a_time_also_by_the_next_coordinator(team, tmp_path):
    planning = PlanningPolicy(zones=(table(FILE),))
    with closing(Journal(tmp_path / "journal.db")) as journal:
        team.begin(journal, planning)
        assert [zone.is_shut for zone in clear(team, "file", for_s=20.0)] == [True]
        team.run(2.0)
    with closing(Journal(tmp_path / "journal.db")) as journal:
        team.begin(journal, planning)
        answer = team.ask(COORDINATOR_ZONES_CHANGE, ZoneChange(), Zones)
        assert (answer.zones[0].is_shut, answer.turns) == (True, [ZoneTurn("file", to_ns(20.0))])
        team.run(19.0)
        assert change(team) == [msgspec.structs.replace(FILE, shut_until_ns=to_ns(20.0))]


def test_a_zone_that_is_unknown_or_a_point_is_not_cleared(team):
    team.begin(None, PlanningPolicy(zones=(table(Zone(name="gate", kind=ZoneKind.PLACE, corners_m=((1.0, 1.0),))),)))
    with pytest.raises(CallError, match="there is no zone dock; known are gate"):
        clear(team, "dock")
    with pytest.raises(CallError, match="zone gate: expected corners_m around an area"):
        clear(team, "gate")
