"""Requests for zones: who waits for whom, and that no two robots have a zone, whatever messages are lost."""

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.algorithms.navigation.reservations import ReservedArea, TeammateRequests, blockers, reserved_areas
from robrain.protocol.model.claim import Reservation
from robrain.protocol.model.zone import Zone, ZoneKind


def box(name: str, x0: float, x1: float, kind: ZoneKind = ZoneKind.RESERVED, **fields: bool) -> Zone:
    return Zone(name=name, kind=kind, corners_m=((x0, 0.0), (x1, 0.0), (x1, 2.0), (x0, 2.0)), **fields)


def request(robot: str, since_ns: int = 0, *zones: str, has: bool = False) -> Reservation:
    return Reservation(robot=robot, zones=zones or ("gate",), since_ns=since_ns, has=has)


def teammate(*reservations: Reservation, is_fresh: bool = True) -> TeammateRequests:
    return TeammateRequests(reservations, is_fresh)


OWN = request("r1", 5)


def test_zones_nearer_than_a_metre_are_reserved_together_also_by_a_third_between_them() -> None:
    zones = [box("a", 0, 1), box("c", 2.4, 4), box("far", 5.2, 6), box("b", 1.5, 2), box("slow", 0, 9, ZoneKind.PLACE)]
    assert sorted(area.names for area in reserved_areas(zones)) == [("a", "b", "c"), ("far",)]


def test_a_lift_is_a_reserved_zone_that_touches_a_door_and_a_shut_door_is_no_area() -> None:
    [lift] = reserved_areas([box("cabin", 0, 2), box("door", 2, 2.4, ZoneKind.DOOR)])
    assert (lift.names, lift.doors, lift.is_exclusive) == (("cabin", "door"), ("door",), True)
    [door] = reserved_areas([box("door", 2, 2.4, ZoneKind.DOOR)])
    assert not door.is_exclusive
    assert reserved_areas([box("door", 2, 2.4, ZoneKind.DOOR, is_shut=True)]) == []


def test_the_distance_from_an_area_is_zero_inside_and_goes_to_the_nearest_side_outside() -> None:
    area = ReservedArea([box("a", 0, 1), box("b", 1.5, 2)])
    places = np.array([(0.5, 1.0), (1.2, 1.0), (3.0, 3.0), (-1.0, 1.0)])
    assert area.distance_m(places) == pytest.approx([0.0, 0.2, 2**0.5, 1.0])
    assert area.may_meet(places[2:3], 1.1)
    assert not area.may_meet(places[2:3], 0.9)


def test_a_request_is_granted_once_all_robots_have_received_it() -> None:
    assert blockers(OWN, {"r2": teammate(OWN), "r3": teammate()}) == ["r3"]
    assert blockers(OWN, {"r2": teammate(OWN), "r3": teammate(OWN)}) == []
    older = msgspec.structs.replace(OWN, since_ns=4)
    assert blockers(OWN, {"r2": teammate(older)}) == ["r2"]


def test_it_waits_for_the_robot_that_is_there_and_for_earlier_requests_in_their_order() -> None:
    others = {
        "r2": teammate(OWN, request("r2", 4)),
        "r3": teammate(OWN, request("r3", 9, has=True)),
        "r4": teammate(OWN, request("r4", 3)),
        "r5": teammate(OWN, request("r5", 6)),
        "r6": teammate(OWN, request("r6", 1, "elsewhere", has=True)),
    }
    assert blockers(OWN, others) == ["r3", "r4", "r2"]


def test_a_silent_robot_keeps_its_zones_and_otherwise_does_not_count_while_more_than_half_answer() -> None:
    silent = teammate(is_fresh=False)
    assert blockers(OWN, {"r2": teammate(OWN), "r3": silent}) == []
    assert blockers(OWN, {"r2": silent}) == ["r2"]
    assert blockers(OWN, {"r2": teammate(OWN), "r3": teammate(request("r3", 9), is_fresh=False)}) == ["r3"]


def test_a_request_that_only_another_robot_has_received_counts() -> None:
    others = {"r2": teammate(OWN, request("r3", 9)), "r3": teammate(is_fresh=False)}
    assert blockers(OWN, others) == ["r3"]
    del others["r3"]
    assert blockers(OWN, others) == ["r3"]


@given(st.integers(0, 2**32 - 1), st.integers(2, 5), st.floats(0.0, 0.9))
def test_no_two_robots_have_a_zone_whatever_messages_are_lost_or_late(seed: int, count: int, loss: float) -> None:
    """Each step a robot requests, releases or publishes; each message is lost, or arrives after a while, in order."""
    rng = np.random.default_rng(seed)
    names = [f"r{number}" for number in range(count)]
    ahead = {name: int(rng.integers(200)) for name in names}
    """How far each clock is ahead."""
    own: dict[str, Reservation | None] = dict.fromkeys(names)
    known: dict[str, dict[str, tuple[Reservation, ...]]] = {
        name: {other: () for other in names if other != name} for name in names
    }
    transit: dict[tuple[str, str], list[tuple[Reservation, ...]]] = {(a, b): [] for a in names for b in names if a != b}
    for step in range(150):
        name = names[int(rng.integers(count))]
        mine = own[name]
        if mine is None:
            own[name] = request(name, step + ahead[name])
        elif mine.has:
            own[name] = None if rng.random() < 0.2 else mine
        elif not blockers(mine, {other: TeammateRequests(heard, True) for other, heard in known[name].items()}):
            own[name] = msgspec.structs.replace(mine, has=True)
        assert sum(one is not None and one.has for one in own.values()) <= 1
        theirs = [one for other, heard in known[name].items() for one in heard if one.robot == other]
        message = tuple(one for one in [own[name], *theirs] if one is not None)
        for other in names:
            if other != name and rng.random() >= loss:
                transit[name, other].append(message)
        for (sender, receiver), waiting in transit.items():
            while waiting and rng.random() < 0.3:
                known[receiver][sender] = waiting.pop(0)
