"""The coordinator keeps the team's zones, and refuses tasks that they make impossible."""

from contextlib import closing

import msgspec
import pytest

from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.errors import CallError
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.tasks.task_messages import TASK_SUBMIT, TaskSubmission
from robrain.protocol.messages.team.door_messages import DOOR_STATE, DoorPosition, DoorState
from robrain.protocol.messages.team.zone_messages import COORDINATOR_ZONES, COORDINATOR_ZONES_CHANGE, ZoneChange, Zones
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.model.zone import ZONES_MAX, Zone, ZoneKind, ZoneTable


def box(name, x0, y0, x1, y1, kind=ZoneKind.KEEP_OUT, **fields):
    return Zone(name=name, kind=kind, corners_m=((x0, y0), (x1, y0), (x1, y1), (x0, y1)), **fields)


CORNER = box("corner", 3.0, 3.0, 4.5, 4.5)
MIDDLE = box("middle", 6.0, 0.0, 7.0, 20.0)
FILE = box("file", 0.0, 0.0, 1.0, 1.0)


def table(zone):
    return ZoneTable(**msgspec.structs.asdict(zone))


def change(team, *put, remove=()):
    return team.ask(COORDINATOR_ZONES_CHANGE, ZoneChange(put=[*put], remove=[*remove]), Zones).zones


def refusal(team, x_m, y_m):
    with pytest.raises(CallError) as refused:
        team.ask(TASK_SUBMIT, task(x_m, y_m))
    return str(refused.value)


def task(x_m, y_m):
    return TaskSubmission(task=Task(id=f"t{x_m}-{y_m}", kind="visit", place=Point2D(x_m, y_m)))


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
