"""Which charger a robot chooses, when it yields to another robot, and where it waits; on fakes."""

import math

import pytest

from robrain.plugins.behavior.errand import SETTLE_S, Failed
from robrain.plugins.behavior.recharge import (
    APART_M,
    ASIDE_M,
    CLEAR_M,
    DOCK_TRIES,
    DOCKED_M,
    GIVE_S,
    GIVEN_S,
    LEFT_OUT_S,
    NEAR_M,
    RICH_S,
    SEEK_BLOCKED_S,
    SEEK_RINGS,
    SEEK_WAIT_S,
    SPARE_S,
    TOUCH_S,
    URGENT_S,
    Docking,
    Queue,
)
from robrain.plugins.behavior.travel import TravelState
from robrain.plugins.skill.home import ChargerPlace
from robrain.plugins.unit.driver.interface import Motion
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task
from tests.plugins.behavior.bare_errand import BareErrand, other, run

WANTED, NEAR, FAR = ChargerPlace(5.0, 0.0), ChargerPlace(2.0, 0.0), ChargerPlace(9.0, 0.0)
AWAY = Point2D(50.0, 50.0)


def queue(*others, priority=3.4):
    errand = BareErrand(*others)
    return errand, Queue(errand, Task(id="c", kind="recharge", place=WANTED.place, priority=priority), None)


# -- which ------------------------------------------------------------------------------------------------------


def test_wanted_charger_is_chosen_while_nobody_has_it_whatever_is_nearer():
    assert queue(NEAR, FAR)[1].choose() == WANTED


def test_nearest_that_nobody_has_takes_the_place_of_one_that_is_taken():
    errand, one = queue(FAR, NEAR)
    errand.others = [other("r1", 5.0, 0.1)]
    assert one.choose() == NEAR
    errand.others.append(other("r2", 2.0, 0.0))
    assert one.choose() == FAR
    errand.others.append(other("r3", 9.0, 0.0))
    assert one.choose() is None


def test_charger_that_was_of_no_use_is_left_out_for_its_time_and_the_last_trouble_told_when_all_are():
    errand, one = queue(NEAR)
    one.leave_out(WANTED, "it gives nothing")
    assert one.choose() == NEAR
    one.leave_out(NEAR, "it has stopped")
    with pytest.raises(Failed, match="it has stopped"):
        one.choose()
    errand.wait(LEFT_OUT_S)
    assert one.choose() == WANTED


def test_charger_that_was_given_to_a_mate_counts_as_the_mates_for_its_time():
    errand, one = queue(NEAR)
    run(one.give_up_place(WANTED))
    assert one.choose() == NEAR
    errand.wait(GIVEN_S)
    assert one.choose() == WANTED


# -- the way there ----------------------------------------------------------------------------------------------


def test_way_to_the_charger_has_the_tasks_priority_and_ends_there():
    errand, one = queue(priority=3.4)
    errand.progress = [TravelState.MOVING, TravelState.WAITING]
    assert run(one.reach(WANTED)) == {"reached": True}
    assert errand.set_out == [(WANTED.place, 3.4)]
    assert errand.stands == 1


def test_robot_that_has_arrived_settles_before_it_stands():
    errand, one = queue()
    errand.driver.state = Motion.DRIVING
    script = one.reach(WANTED)
    assert run(script, 3) is ...
    errand.wait(SETTLE_S - 0.001)
    assert run(script, 1) is ...
    assert errand.stands == 0
    errand.wait(0.001)
    assert run(script) == {"reached": True}
    assert errand.stands == 1


def test_charger_to_which_there_is_no_way_is_left_out():
    errand, one = queue(NEAR)
    errand.no_way_to = [WANTED.place]
    assert run(one.reach(WANTED)) == {}
    assert one.choose() == NEAR


@pytest.mark.parametrize("trouble", [TravelState.BLOCKED, TravelState.NO_PATH, TravelState.LOST])
def test_trouble_on_the_way_leaves_the_charger_out_and_the_robot_stands(trouble):
    errand, one = queue(NEAR)
    errand.progress = [TravelState.MOVING, trouble]
    assert run(one.reach(WANTED)) == {}
    assert errand.stands == 1
    assert one.choose() == NEAR


# -- who needs it more ------------------------------------------------------------------------------------------


def waits(name="r1", endurance_s=100.0):
    return other(name, 3.0, 3.0, AWAY, behavior="recharge", endurance_s=endurance_s)


@pytest.mark.parametrize(
    ("mine_s", "theirs_s", "gives"),
    [
        (100.0 + SPARE_S, 100.0, True),
        (100.0 + SPARE_S - 1.0, 100.0, False),
        (URGENT_S + SPARE_S, URGENT_S, False),
        (URGENT_S + RICH_S, URGENT_S, True),
        (URGENT_S + RICH_S - 1.0, URGENT_S, False),
        (URGENT_S - 1.0 + SPARE_S, URGENT_S - 1.0, True),
    ],
)
def test_robot_makes_room_for_one_that_lasts_so_much_less(mine_s, theirs_s, gives):
    errand, one = queue()
    errand.board.energy.usable_j = 10.0 * mine_s
    errand.others = [waits(endurance_s=theirs_s), waits("r2", 5000.0)]
    assert one.must_give(WANTED) is gives


def test_robot_keeps_its_place_while_nobody_waits_or_its_own_energy_is_not_known():
    errand, one = queue()
    assert not one.must_give(WANTED)
    errand.others = [other("r1", 3.0, 3.0, AWAY, behavior="explore", endurance_s=1.0)]
    assert not one.must_give(WANTED)
    errand.others = [waits()]
    assert one.must_give(WANTED)
    errand.board.energy = None
    assert not one.must_give(WANTED)


@pytest.mark.parametrize(
    ("name", "endurance_s", "gives"),
    [("r1", 601.0, False), ("r1", 599.0, True), ("r9", 600.0, False), ("r1", 600.0, True)],
)
def test_of_those_who_charge_the_one_that_lasts_longest_makes_room_and_by_name_if_they_last_alike(
    name, endurance_s, gives
):
    errand, one = queue(NEAR)
    errand.others = [waits(), other(name, 2.0, 0.0, behavior="recharge", endurance_s=endurance_s)]
    assert one.must_give(WANTED) is gives


# -- where to wait ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("away_m", "stays"), [(CLEAR_M, True), (NEAR_M, True), (CLEAR_M - 0.01, False), (3.01, False)])
def test_robot_that_is_near_a_charger_and_clear_of_it_waits_where_it_is(away_m, stays):
    errand, one = queue()
    errand.at = Pose2D(5.0 - away_m, 0.0, 0.0)
    run(one.move_aside())
    assert (errand.gone == []) is stays


def test_robot_waits_at_the_nearest_place_beside_the_charger():
    errand, one = queue()
    run(one.move_aside())
    (place,) = errand.gone
    assert (place.x_m, place.y_m) == pytest.approx((5.0 - ASIDE_M[1], 0.0))


def test_place_that_cannot_be_reached_is_passed_over_and_without_any_the_robot_stays():
    errand, one = queue()
    run(one.move_aside())
    errand.no_way_to = [errand.gone[0]]
    run(one.move_aside())
    assert errand.gone[1] != errand.gone[0]
    errand.travel.plan = lambda place: [Point2D(place.x_m + APART_M + 0.001, place.y_m)]  # as near as it gets
    run(one.move_aside())
    assert len(errand.gone) == 2


def test_robot_waits_and_makes_room_until_a_charger_is_free_or_all_are_left_out():
    errand, one = queue()
    errand.at = Pose2D(3.0, 0.0, 0.0)
    errand.others = [other("r1", 5.0, 0.0)]
    script = one.wait()
    assert run(script, 4) is ...
    assert (errand.made_room, errand.stands) == (4, 0)
    errand.others = []
    assert run(script) is None
    assert (errand.made_room, errand.stands) == (4, 1)
    errand.others = [other("r1", 5.0, 0.0)]
    one.leave_out(WANTED, "of no use")
    assert run(one.wait(), 5) is None


def test_robot_waits_beside_a_charger_that_is_of_use_where_its_robot_sees_it():
    errand, one = queue(ChargerPlace(30.0, 0.0))
    errand.at = Pose2D(3.0, 0.0, 0.0)
    errand.others = [other("r1", 30.0, 0.0)]
    one.leave_out(WANTED, "it gives nothing")
    run(one.wait(), 2)
    (place,) = errand.gone
    assert CLEAR_M <= place.distance_m(Point2D(30.0, 0.0)) <= NEAR_M


STEP_S = 0.25


def docking(yaw_rad=None):
    errand = BareErrand()
    return errand, Docking(errand, ChargerPlace(2.0, 1.0, yaw_rad), 10.0)


def play(errand, script, limit_s=600.0, each=lambda: None):
    """Run a script on a simulated clock: its result and duration, or ... if it is still running."""
    steps = round(limit_s / STEP_S)
    for number in range(steps):
        try:
            next(script)
        except StopIteration as end:
            return end.value, number * STEP_S
        errand.wait(STEP_S)
        each()
    return ..., limit_s


def keeps(_charger):
    return False


# -- onto the contacts ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("yaw_rad", "facing_rad"), [(1.0, 1.0), (None, 0.5)])
def test_robot_goes_to_the_place_in_odom_and_looks_where_the_charger_says_or_as_it_does(yaw_rad, facing_rad):
    errand, one = docking(yaw_rad)
    errand.at = Pose2D(2.0, 1.0, 0.5)
    errand.charging = True
    errand.board.T_arena_odom = Pose2D(1.0, 0.0, math.pi / 2)
    run(one.dock())
    (sent,) = errand.driver.sent
    assert (sent.x_m, sent.y_m) == pytest.approx((1.0, -1.0))
    assert sent.yaw_rad == pytest.approx(facing_rad - math.pi / 2)


@pytest.mark.parametrize(("away_m", "tries"), [(DOCKED_M, 1), (DOCKED_M + 0.001, DOCK_TRIES)])
def test_robot_tries_again_until_it_stands_near_enough(away_m, tries):
    errand, one = docking()
    errand.at = Pose2D(2.0 + away_m, 1.0, 0.0)
    errand.charging = True
    run(one.dock())
    assert len(errand.driver.sent) == tries


def test_robot_that_does_not_know_where_it_is_does_not_dock():
    errand, one = docking()
    errand.board.T_arena_odom = None
    with pytest.raises(Failed, match="does not know where it is"):
        run(one.dock())


def test_robot_waits_for_the_first_current_and_no_longer_than_its_time():
    errand, one = docking()
    errand.at = Pose2D(2.0, 1.0, 0.0)
    assert play(errand, one.dock())[1] == pytest.approx(TOUCH_S + STEP_S)
    assert errand.driver.sent
    errand.charging = True
    assert play(errand, one.dock())[1] == STEP_S


# -- at the charger ---------------------------------------------------------------------------------------------


def test_robot_charges_until_there_is_enough():
    errand, one = docking()
    errand.charging = True

    def fill():
        errand.soc += 0.01

    assert play(errand, one.charge(0.7, keeps), each=fill)[0] is False
    assert errand.soc == pytest.approx(0.7, abs=0.02)
    assert one.has_charged
    assert errand.driver.sent == []


@pytest.mark.parametrize("gives_after_s", [0.0, 1.0])
def test_whether_a_mate_needs_the_charger_is_looked_at_every_two_seconds(gives_after_s):
    errand, one = docking()
    errand.charging, asked_ns = True, []

    def must_give(charger):
        assert charger.place == one._charger.place
        asked_ns.append(errand.clock.now_ns())
        return len(asked_ns) == 1 + round(gives_after_s)

    gives, took_s = play(errand, one.charge(0.9, must_give))
    assert gives is True
    assert took_s == gives_after_s * GIVE_S


def test_charger_that_gives_no_more_is_left_after_its_time():
    errand, one = docking()
    errand.charging = True
    script = one.charge(0.9, keeps)
    play(errand, script, 5.0)
    errand.charging = False
    gives, took_s = play(errand, script)
    assert gives is False
    assert took_s == pytest.approx(10.0, abs=2 * STEP_S)
    assert one.has_charged
    assert errand.driver.sent == []  # it has been on the contacts: nothing is sought


# -- seeking ----------------------------------------------------------------------------------------------------


def test_robot_that_gets_no_current_looks_for_the_contacts_around_from_the_inside_out_and_once():
    errand, one = docking(0.0)
    gives, took_s = play(errand, one.charge(0.9, keeps))
    assert gives is False
    away = [
        (math.hypot(at.x_m - 2.0, at.y_m - 1.0), math.atan2(at.y_m - 1.0, at.x_m - 2.0)) for at in errand.driver.sent
    ]
    expected = [
        (radius_m, math.remainder(index * math.tau / places, math.tau))
        for radius_m, places in SEEK_RINGS
        for index in range(places)
    ]
    for (radius_m, angle_rad), (expected_m, expected_rad) in zip(away, expected, strict=True):
        assert radius_m == pytest.approx(expected_m)
        assert math.remainder(angle_rad - expected_rad, math.tau) == pytest.approx(0.0, abs=1e-9)
    # At each place it waits for a current; then for as long as a charger may give nothing.
    assert took_s == pytest.approx(26 * (SEEK_WAIT_S + 0.3) + 10.0, abs=10.0)
    assert took_s > 26 * SEEK_WAIT_S + 10.0


def test_place_where_something_stands_is_passed_over_at_once():
    errand, one = docking()
    errand.driver.state, errand.driver.blocked = Motion.BLOCKED, SEEK_BLOCKED_S
    script = one._seek()
    _, took_s = play(errand, script)
    assert errand.driver.stops == len(errand.driver.sent) == 26
    assert took_s == pytest.approx(26 * STEP_S)


def test_robot_that_does_not_get_aside_stands_where_it_is():
    errand, one = queue()

    def fail(_goal):
        raise Failed("blocked")
        yield

    errand.go = fail
    assert run(one.move_aside()) == {}
    assert errand.stands == 1
