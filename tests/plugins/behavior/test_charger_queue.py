"""Which charger a robot chooses, when it yields to another robot, and where it waits; on fakes."""

import math

import pytest

from robrain.plugins.behavior.errand import SETTLE_S, Failed
from robrain.plugins.behavior.recharge import (
    APART_M,
    ASIDE_M,
    CLEAR_M,
    GIVEN_S,
    LEFT_OUT_S,
    NEAR_M,
    RICH_S,
    SPARE_S,
    URGENT_S,
    Queue,
)
from robrain.plugins.behavior.travel import TravelState
from robrain.plugins.skill.home import ChargerPlace
from robrain.plugins.unit.driver.interface import Motion
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task
from tests.plugins.behavior.bare_errand import BareErrand, mate, run

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
    errand.mates = [mate("r1", 5.0, 0.1)]
    assert one.choose() == NEAR
    errand.mates.append(mate("r2", 2.0, 0.0))
    assert one.choose() == FAR
    errand.mates.append(mate("r3", 9.0, 0.0))
    assert one.choose() is None


def test_charger_that_home_knows_as_well_is_not_counted_twice():
    errand, one = queue(ChargerPlace(5.3, 0.0))
    errand.mates = [mate("r1", 5.0, 0.0)]
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


@pytest.mark.parametrize(("priority", "told"), [(3.4, 3), (3.6, 4), (1e6, 100)])
def test_way_to_the_charger_has_the_tasks_priority_and_ends_there(priority, told):
    errand, one = queue(priority=priority)
    errand.progress = [TravelState.MOVING, TravelState.WAITING]
    assert run(one.reach(WANTED)) == {"reached": True}
    assert errand.set_out == [(WANTED.place, told)]
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


def test_charger_that_a_mate_takes_meanwhile_is_not_left_out_but_not_driven_to_either():
    errand, one = queue()
    errand.progress = [TravelState.MOVING] * 5
    errand.mates = [mate("r1", 5.0, 0.0)]
    assert run(one.reach(WANTED)) == {}
    assert errand.stands == 1
    errand.mates = []
    assert one.choose() == WANTED


# -- who needs it more ------------------------------------------------------------------------------------------


def waits(name="r1", endurance_s=100.0):
    return mate(name, 3.0, 3.0, AWAY, behavior="recharge", endurance_s=endurance_s)


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
    errand.mates = [waits(endurance_s=theirs_s), waits("r2", 5000.0)]
    assert one.must_give(WANTED) is gives


def test_robot_keeps_its_place_while_nobody_waits_or_its_own_energy_is_not_known():
    errand, one = queue()
    assert not one.must_give(WANTED)
    errand.mates = [mate("r1", 3.0, 3.0, AWAY, behavior="explore", endurance_s=1.0)]
    assert not one.must_give(WANTED)
    errand.mates = [waits()]
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
    errand.mates = [waits(), mate(name, 2.0, 0.0, behavior="recharge", endurance_s=endurance_s)]
    assert one.must_give(WANTED) is gives


def test_robot_that_draws_nothing_lasts_long_and_not_for_ever():
    errand, one = queue()
    errand.board.energy.usual_power_w = 0.0
    errand.mates = [waits(endurance_s=6000.0 / 0.1 - RICH_S)]
    assert one.must_give(WANTED)
    errand.mates = [waits(endurance_s=6000.0 / 0.1 - RICH_S + 1.0)]
    assert not one.must_give(WANTED)


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


def test_place_that_is_too_near_to_a_charger_or_to_mates_or_where_they_go_is_passed_over():
    errand, one = queue(ChargerPlace(3.5, 0.0))
    # The nearest charger is now the other one; its two nearest places are taken.
    nearest = Point2D(3.5 - ASIDE_M[1], 0.0)
    errand.mates = [mate("r1", nearest.x_m, nearest.y_m + 0.2 + 0.2 + APART_M - 0.01)]
    run(one.move_aside())
    assert errand.gone[0] != nearest
    errand.mates = [mate("r1", nearest.x_m, nearest.y_m + 0.2 + 0.2 + APART_M + 0.01)]
    run(one.move_aside())
    assert errand.gone[1].x_m == pytest.approx(nearest.x_m)
    errand.mates = [mate("r1", 3.0, 4.0, Point2D(nearest.x_m, nearest.y_m + 0.2 + 0.2 + APART_M - 0.01))]
    run(one.move_aside())
    assert errand.gone[2].x_m != pytest.approx(nearest.x_m)
    for place in errand.gone:
        assert all(math.dist((place.x_m, place.y_m), (each.x_m, each.y_m)) >= CLEAR_M for each in one._known())


def test_place_that_cannot_be_reached_is_passed_over_and_without_any_the_robot_stays():
    errand, one = queue()
    run(one.move_aside())
    errand.no_way_to = [errand.gone[0]]
    run(one.move_aside())
    assert errand.gone[1] != errand.gone[0]
    errand.travel.plan = lambda place: [Point2D(place.x_m + APART_M + 0.001, place.y_m)]  # as near as it gets
    run(one.move_aside())
    assert len(errand.gone) == 2


def test_robot_at_a_charger_that_others_have_waits_aside_of_it():
    errand, one = queue(ChargerPlace(5.0, 0.9))
    errand.at = Pose2D(5.0, 0.3, 0.0)
    errand.mates = [mate("r1", 5.0, 0.0), mate("r2", 5.0, 0.9)]
    run(one.wait(), 3)
    (place,) = errand.gone
    assert all(math.dist((place.x_m, place.y_m), (5.0, y_m)) >= CLEAR_M for y_m in (0.0, 0.9))


def test_robot_that_does_not_get_aside_stands_where_it_is():
    errand, one = queue()

    def fail(_goal):
        raise Failed("blocked")
        yield

    errand.go = fail
    assert run(one.move_aside()) == {}
    assert errand.stands == 1


def test_robot_waits_and_makes_room_until_a_charger_is_free_or_all_are_left_out():
    errand, one = queue()
    errand.at = Pose2D(3.0, 0.0, 0.0)
    errand.mates = [mate("r1", 5.0, 0.0)]
    script = one.wait()
    assert run(script, 4) is ...
    assert (errand.made_room, errand.stands) == (4, 0)
    errand.mates = []
    assert run(script) is None
    assert (errand.made_room, errand.stands) == (4, 1)
    errand.mates = [mate("r1", 5.0, 0.0)]
    one.leave_out(WANTED, "of no use")
    assert run(one.wait(), 5) is None
