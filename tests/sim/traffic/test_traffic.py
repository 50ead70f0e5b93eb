import math
from itertools import pairwise

import numpy as np
import pytest

from robrain import Scenario
from robrain.protocol.messages.team.arena_messages import BodyKind
from robrain.protocol.model.geometry import Point2D
from robrain.sim.traffic.specs import DoorSpec
from robrain.sim.traffic.traffic import Door, Walkways

ROOMS = """
[scenario]
name = "rooms"
time_limit_s = 90.0
[floor]
size_m = [8.0, 4.0]
walls = [
    { from_m = [4.0, 0.0], to_m = [4.0, 1.4] },
    { from_m = [4.0, 2.6], to_m = [4.0, 4.0] },
]
[team]
robots = 1
near_m = [1.0, 3.0]
"""
DOOR = "[[doors]]\nfrom_m = [4.0, 1.4]\nto_m = [4.0, 2.6]\n"
MOVER = "[[movers]]\nvia_m = [[2.0, 0.8], [3.0, 0.8]]\nspeed_m_s = 0.5\npause_s = 1.0\n"
PEOPLE = "[[people]]\nplaces_m = [[3.0, 0.8], [7.0, 0.8], [7.0, 3.3]]\ncount = 2\npause_s = [0.0, 1.0]\n"


def opened(toml: str, **changes: object):
    scenario = Scenario.from_toml(ROOMS + toml).replace(**changes)
    return scenario.open(scenario.world())


def bodies(run) -> dict[str, tuple[float, float]]:
    return {body.body: (body.pose.x_m, body.pose.y_m) for body in run.truth.bodies}


def ranges_ahead(run) -> float:
    """What the lidar of a robot in the west measures towards the middle of the door."""
    robot = run.arena._robots[0]
    hulls = run.arena._team._hulls
    turn = robot.lidar.scan(robot.body.pose.__class__(3.0, 2.0, math.pi), hulls)
    return turn.ranges_mm[0] / 1000


def door(toml: str = "", **fields: object) -> Door:
    spec = DoorSpec(from_m=(4.0, 1.4), to_m=(4.0, 2.6), **fields)
    return Door("door1", spec, np.random.default_rng(1))


@pytest.mark.slow
def test_a_closed_door_is_a_wall_for_lidars_until_it_opens():
    run = opened(DOOR + "open_s = [[0.5, 1.0]]\n")
    try:
        assert ranges_ahead(run) == pytest.approx(0.95, abs=0.08)
        assert [body.kind for body in run.truth.bodies] == [BodyKind.DOOR]
        while run.sim_time_s < 0.5:
            run.tick()
        assert ranges_ahead(run) > 4.0
        assert run.truth.bodies == []
        while run.sim_time_s < 1.0:
            run.tick()
        assert ranges_ahead(run) == pytest.approx(0.95, abs=0.08)
    finally:
        run.close()


@pytest.mark.slow
def test_a_robot_goes_through_a_door_while_it_is_open():
    scenario = Scenario.from_toml(ROOMS + DOOR + "period_s = 10.0\nopen_share = 0.3\nphase_s = 0.0\n")
    result = scenario.run(until_explored=0.95)
    assert (result.ended, result.collisions) == ("explored", 0)
    assert result.per_robot[0].distance_m > 1.5


def test_a_door_stays_open_while_somebody_stands_in_it():
    mine = door(period_s=10.0, open_share=0.5, phase_s=0.0)
    in_it, beside = (4.2, 2.0, 0.2), (4.8, 2.0, 0.2)
    assert not mine.step(1.0, [in_it])  # open already
    assert not mine.step(6.0, [in_it])
    assert mine.is_open
    assert mine.step(6.1, [beside])
    assert not mine.is_open
    assert mine.step(10.0, [beside])
    assert mine.is_open


@pytest.mark.slow
def test_people_walk_through_doorways_clear_of_walls_and_draw_their_way_from_the_seed():
    ways = []
    for seed in (1, 2):
        run = opened(PEOPLE, seed=seed)
        try:
            way = []
            for _ in range(1500 if seed == 1 else 300):
                run.tick()
                way.append(bodies(run))
        finally:
            run.close()
        ways.append(way)
    assert ways[0][:300] != ways[1]
    plan = Scenario.from_toml(ROOMS).plan()
    places = [place for step in ways[0] for place in step.values()]
    rows, columns = zip(*(plan.geometry.cell_of(*place) for place in places), strict=True)
    assert plan.clearance_m[list(rows), list(columns)].min() >= 0.2
    assert any(x_m < 3.5 for x_m, _ in places)
    assert any(x_m > 4.5 for x_m, _ in places)


@pytest.mark.slow
@pytest.mark.parametrize(("stop_m", "collisions"), [(0.6, 0), (0.0, 1)])
def test_a_mover_stops_for_a_robot_if_it_is_to_and_else_hits_it(stop_m, collisions):
    run = opened(f"[[movers]]\nvia_m = [[3.0, 0.5], [0.5, 0.5]]\nstop_m = {stop_m}\n")
    try:
        robot = run.arena._robots[0].body
        robot.carry_to(robot.pose.__class__(1.5, 0.5, 0.0))
        run.switch_off("r1")
        for _ in range(200):
            run.tick()
        assert run.arena.collisions == collisions
        gap_m = bodies(run)["mover1"][0] - robot.x_m - 0.5
        assert gap_m == pytest.approx(0.6, abs=0.02) if stop_m else gap_m < 0.02
    finally:
        run.close()


@pytest.mark.slow
def test_a_person_that_a_robot_blocks_turns_back():
    run = opened("[[people]]\nplaces_m = [[7.0, 0.8], [0.6, 0.8]]\npause_s = [0.0, 0.0]\n", seed=2)
    try:
        robot = run.arena._robots[0].body
        robot.carry_to(robot.pose.__class__(4.0, 2.0, 0.0))  # in the doorway
        run.switch_off("r1")
        sides = set()
        for _ in range(2000):
            run.tick()
            x_m, _ = bodies(run)["person1"]
            sides.add(x_m > 4.0)
        assert len(sides) == 1
        assert run.arena.collisions == 0
    finally:
        run.close()


def test_ways_go_around_walls_and_are_short():
    plan = Scenario.from_toml(ROOMS).plan()
    walkways = Walkways(plan, 0.25)
    way = walkways.path(Point2D(3.0, 0.8), Point2D(5.0, 0.8))
    assert way is not None
    length_m = sum(one.distance_m(other) for one, other in pairwise(way))
    assert 2.0 * math.hypot(1.0, 0.85) <= length_m < 3.1
    assert len(way) <= 5
    assert Walkways(plan, 0.65).path(Point2D(3.0, 0.8), Point2D(5.0, 0.8)) is None
