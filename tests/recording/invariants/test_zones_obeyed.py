"""Zones are obeyed: what breaks that, and what does not."""

import pytest

from robrain.protocol.messages.team.zone_messages import Zones
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.zone import Zone, ZoneKind
from robrain.recording.invariants.invariant import Invariant, InvariantState, MissingEvidence
from robrain.recording.invariants.zone_invariants import LEFT_NS
from tests.recording.invariants.team_script import TeamScript

SQUARE = ((4.0, 4.0), (6.0, 4.0), (6.0, 6.0), (4.0, 6.0))
SHUT = Zone(name="shut", kind=ZoneKind.KEEP_OUT, corners_m=SQUARE)
SLOW = Zone(name="slow", kind=ZoneKind.SPEED_LIMIT, corners_m=SQUARE, speed_m_s=0.2)


@pytest.fixture
def script():
    script = TeamScript()
    script.states["r1"] = {"pose": None}
    script.truths["r1"] = {"at": (1.0, 1.0)}
    return script


def located(script, **state):
    script.states["r1"] = {"pose": Pose2D(1.0, 1.0, 0.0), **state}


def drive(script, seconds, speed_m_s):
    for _ in range(round(seconds / 0.2)):
        script.truths["r1"]["distance_m"] = script.truths["r1"].get("distance_m", 0.0) + 0.2 * speed_m_s
        script.pass_time(0.2)


def test_without_zones_nothing_is_judged(script):
    script.pass_time(5.0)
    ruling = script.ruling(Invariant.ZONES)
    assert (ruling.state, ruling.missing) == (InvariantState.NOT_JUDGED, MissingEvidence.ZONES)


def test_a_robot_that_enters_a_keep_out_zone_is_found_once(script):
    located(script)
    script.send(Zones(zones=[SHUT]))
    script.pass_time(5.0)
    assert script.ruling(Invariant.ZONES).state is InvariantState.KEPT
    script.truths["r1"]["at"] = (5.0, 5.0)
    script.pass_time(5.0)
    assert script.found(Invariant.ZONES) == [{"code": "entered", "robot": "r1", "zone": "shut"}]


@pytest.mark.parametrize("state", [{"halted": True}, {"lost": "after a fall"}, {"frame": 7}])
def test_a_robot_that_cannot_obey_is_not_judged(script, state):
    located(script, **state)
    script.send(Zones(zones=[SHUT]))
    script.pass_time(5.0)
    script.truths["r1"]["at"] = (5.0, 5.0)
    script.pass_time(100.0)
    assert script.found(Invariant.ZONES) == []


def test_a_zone_for_others_does_not_bind_a_robot(script):
    located(script)
    script.send(Zones(zones=[Zone(name="shut", kind=ZoneKind.KEEP_OUT, corners_m=SQUARE, robots=("r2",))]))
    script.pass_time(5.0)
    script.truths["r1"]["at"] = (5.0, 5.0)
    script.pass_time(5.0)
    assert script.found(Invariant.ZONES) == []


def test_a_robot_must_leave_a_new_zone_in_time(script):
    located(script)
    script.truths["r1"]["at"] = (5.0, 5.0)
    script.pass_time(5.0)
    script.send(Zones(zones=[SHUT]))
    script.pass_time(LEFT_NS / 1e9 - 1.0)
    assert script.found(Invariant.ZONES) == []
    script.pass_time(5.0)
    assert script.codes(Invariant.ZONES) == ["not_left"]


def test_a_robot_may_exceed_a_limit_by_five_per_cent(script):
    located(script)
    script.truths["r1"]["at"] = (5.0, 5.0)
    script.send(Zones(zones=[SLOW]))
    drive(script, 2.0, 0.6)
    script.pass_time(2.0)
    drive(script, 2.0, 0.209)
    assert script.found(Invariant.ZONES) == []
    drive(script, 0.2, 0.22)
    assert script.codes(Invariant.ZONES) == ["too_fast"]


def test_a_robot_that_enters_an_occupied_reserved_zone_is_found(script):
    script.truths["r2"] = {"at": (5.0, 5.0)}
    script.send(Zones(zones=[Zone(name="lane", kind=ZoneKind.RESERVED, corners_m=SQUARE)]))
    script.pass_time(5.0)
    script.truths["r2"]["at"] = (1.0, 5.0)
    script.pass_time(1.0)
    script.truths["r1"]["at"] = (5.0, 5.0)
    script.pass_time(1.0)
    assert script.ruling(Invariant.ZONES).state is InvariantState.KEPT
    script.truths["r2"]["at"] = (5.5, 5.0)
    script.pass_time(1.0)
    assert script.found(Invariant.ZONES) == [{"code": "not_alone", "robot": "r2", "zone": "lane", "other": "r1"}]
