"""Times at chargers: never two robots at one, everybody is served, and nobody waits without need."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.coordinator.parts.charge_schedule import CLEAR_S, ChargerPath, ChargeSeeker, schedule_charges
from robrain.coordinator.planning.energy_budget import CHARGED_SOC, DOCK_S
from robrain.coordinator.team.chargers import LEAST_W, USUAL_W, ChargePower, is_same_charger
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.robots.robot_messages import BatteryState
from robrain.protocol.model.geometry import Point2D

HERE, THERE = Point2D(0.0, 0.0), Point2D(9.0, 0.0)
POWER_W = 20.0
CAPACITY_J = 72_000.0


def seeker(name, soc, *paths_s, **fields):
    places = (HERE, THERE)[: len(paths_s)]
    paths = tuple(ChargerPath(place, travel_s) for place, travel_s in zip(places, paths_s, strict=True))
    return ChargeSeeker(name, soc, CAPACITY_J, paths, **fields)


def schedule(seekers):
    return {turn.robot: turn for turn in schedule_charges(seekers, lambda _: POWER_W)}


def charging_s(gain):
    return gain * CAPACITY_J / POWER_W


# -- one by one -----------------------------------------------------------------------------------------------------


def test_a_robot_alone_sets_out_at_once_and_charges_until_it_is_full():
    turn = schedule([seeker("r1", 0.2, 30.0)])["r1"]
    assert (turn.set_out_s, turn.from_s, turn.to_soc, turn.behind) == (0.0, 30.0, 0.95, "")
    assert turn.until_s == pytest.approx(30.0 + DOCK_S + charging_s(0.75))


def test_one_that_waits_sets_out_so_as_to_be_there_when_the_charger_comes_free():
    turns = schedule([seeker("r1", 0.9, 0.0, bound_for=HERE, is_there=True), seeker("r2", 0.2, 30.0)])
    free_s = charging_s(0.05) + CLEAR_S
    assert turns["r1"].until_s == pytest.approx(free_s - CLEAR_S)
    assert (turns["r2"].from_s, turns["r2"].set_out_s) == (pytest.approx(free_s), pytest.approx(free_s - 30.0))
    assert turns["r2"].behind == "r1"


def test_those_with_least_come_first_and_each_goes_where_it_can_begin_first():
    turns = schedule([seeker("r1", 0.3, 5.0, 50.0), seeker("r2", 0.1, 6.0, 60.0), seeker("r3", 0.2, 7.0, 70.0)])
    assert [turns[name].charger for name in ("r2", "r3", "r1")] == [HERE, THERE, THERE]
    assert turns["r1"].behind == "r3"  # which needs less than r2


def test_who_is_on_its_way_keeps_its_charger_whoever_has_less():
    turns = schedule([seeker("r1", 0.3, 40.0, bound_for=HERE), seeker("r2", 0.05, 5.0)])
    assert turns["r2"].behind == "r1"


def test_a_charge_ends_when_there_is_enough_for_the_tasks_that_wait_for_it():
    there = {"bound_for": HERE, "is_there": True}
    turn = schedule([seeker("r1", 0.3, 0.0, needs_soc=0.42, **there)])["r1"]
    assert (turn.to_soc, turn.until_s) == (0.42, pytest.approx(charging_s(0.12)))
    assert schedule([seeker("r1", 0.5, 0.0, needs_soc=0.42, **there)])["r1"].until_s == 0.0
    assert schedule([seeker("r1", 0.3, 0.0, needs_soc=1.4, **there)])["r1"].to_soc == 0.95
    vain = seeker("r1", 0.3, 0.0, needs_soc=0.42, is_whole=True, **there)
    assert schedule([vain])["r1"].to_soc == 0.95
    assert schedule([seeker("r1", 0.3, 9.0, needs_soc=0.42, bound_for=HERE)])["r1"].to_soc == 0.95


def test_what_a_robot_has_set_itself_is_what_it_charges_to():
    turns = schedule([seeker("r1", 0.3, 0.0, bound_for=HERE, to_soc=0.5), seeker("r2", 0.2, 30.0)])
    assert turns["r1"].to_soc == 0.5


def test_a_charger_that_two_robots_know_at_places_a_little_apart_is_one():
    other = ChargeSeeker("r2", 0.2, CAPACITY_J, (ChargerPath(Point2D(0.3, 0.0), 5.0),))
    turns = schedule([seeker("r1", 0.1, 5.0), other])
    assert turns["r2"].behind == "r1"


# -- any team -------------------------------------------------------------------------------------------------------

PLACES = [Point2D(4.0 * number, 0.0) for number in range(3)]
ways = st.lists(st.floats(0.0, 200.0), min_size=3, max_size=3)
robots = st.tuples(
    st.floats(0.0, 0.99),
    ways,
    st.sets(st.sampled_from(range(3))),
    st.sampled_from([None, None, 0, 1, 2]),
    st.booleans(),
)


@st.composite
def teams(draw):
    found = []
    for number, (soc, ways_s, known, at, whole) in enumerate(draw(st.lists(robots, max_size=8))):
        known_ways = tuple(ChargerPath(PLACES[index], ways_s[index]) for index in sorted(known))
        is_there = at is not None and whole and not any(one.bound_for == PLACES[at] and one.is_there for one in found)
        bound_for = None if at is None else PLACES[at]
        found.append(
            ChargeSeeker(f"r{number}", soc, CAPACITY_J, known_ways, bound_for, is_there, None, draw(st.booleans()))
        )
    return found


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(teams(), st.randoms(use_true_random=False))
def test_never_two_robots_at_one_charger_and_everybody_who_knows_one_is_served(team, shuffle):
    turns = schedule_charges(team, lambda _: POWER_W)
    assert sorted(turn.robot for turn in turns) == sorted(one.name for one in team if one.paths or one.bound_for)
    by_name = {one.name: one for one in team}
    for turn in turns:
        one = by_name[turn.robot]
        known = [way.charger for way in one.paths] if one.bound_for is None else [one.bound_for]
        assert turn.charger in known
        assert 0.0 <= turn.set_out_s <= turn.from_s <= turn.until_s
        # Nobody leaves with less than it came with, and nobody leaves low without tasks that wait for it.
        assert turn.to_soc >= max(one.soc, CHARGED_SOC if one.to_soc is None else 0.0)
        assert turn.until_s >= turn.from_s + charging_s(turn.to_soc - one.soc) - 1e-6
        # It is there as early as it can, and no earlier.
        way_s = next((way.travel_s for way in one.paths if way.charger == turn.charger), 0.0)
        assert one.is_there or turn.from_s >= turn.set_out_s + way_s - 1e-6
        for other in turns:
            if other.robot != turn.robot and is_same_charger(other.charger, turn.charger):
                assert other.from_s >= turn.until_s or turn.from_s >= other.until_s
    mixed = list(team)
    shuffle.shuffle(mixed)
    assert schedule_charges(mixed, lambda _: POWER_W) == turns


@pytest.mark.slow
@settings(max_examples=33, deadline=None)
@given(teams())
def test_nobody_waits_while_a_charger_that_it_knows_stands_empty(team):
    turns = schedule_charges(team, lambda _: POWER_W)
    queues = {place: [turn for turn in turns if turn.charger == place] for place in PLACES}
    for one in team:
        turn = next((turn for turn in turns if turn.robot == one.name), None)
        if turn is None or one.bound_for is not None:
            continue
        for way in one.paths:
            assert queues[way.charger] or turn.from_s <= way.travel_s


# -- what chargers give ---------------------------------------------------------------------------------------------


def battery(remaining_j):
    return BatteryState(
        voltage_v=16.0, current_a=-1.0, temperature_c=20.0, soc=0.5, remaining_j=remaining_j, charging=True
    )


def test_the_power_of_a_charger_is_learned_from_who_stands_at_it():
    power = ChargePower()
    assert power.of(HERE) == USUAL_W
    power.record("r1", HERE, battery(1000.0), 0)
    power.record("r1", HERE, battery(1050.0), to_ns(2.0))
    assert power.of(HERE) == USUAL_W
    power.record("r1", HERE, battery(1300.0), to_ns(10.0))
    assert power.of(Point2D(0.2, 0.0)) == 30.0
    assert power.of(THERE) == USUAL_W
    power.record("r1", HERE, battery(1300.0), to_ns(20.0))
    assert power.of(HERE) == LEAST_W
    power.stop("r1")
    power.record("r1", HERE, battery(1300.0), to_ns(60.0))
    power.record("r1", HERE, battery(1500.0), to_ns(70.0))
    assert power.of(HERE) == 20.0
