"""Robots that meet: nobody touches anybody, nobody waits for ever, and no coordinator is asked.

All that is real but the world: arena, hosts, stock plugins. The corridor is as narrow as the map's cells and the
planner's margin allow; there the lidars are without noise, because one wrong reading closes it for a moment.
"""

import pytest

from robrain.lab.bench.traffic import floor_of
from robrain.plugins.behavior.travel import TravelState
from robrain.protocol.model.geometry import Point2D
from robrain.sim.robot.lidar import LidarSpec
from tests.plugins.behavior.crossing import Crossing

P = Point2D
DEADLOCK_S = 10.0
ROOMS_AND_CORRIDOR = (12.0, 4.0, (0.3, 0.5, 2.1, 3.5), (9.9, 0.5, 11.7, 3.5), (2.1, 1.7, 9.9, 2.3))
BAY = (5.6, 2.3, 6.4, 3.0)
DOORWAY = (8.0, 5.0, (0.3, 0.3, 3.9, 4.7), (4.1, 0.3, 7.7, 4.7), (3.9, 2.0, 4.1, 2.9))
CROSSING = (7.0, 7.0, (0.3, 3.0, 6.7, 4.0), (3.0, 0.3, 4.0, 6.7))
HALL = (7.0, 7.0, (0.3, 0.3, 6.7, 6.7))
EXACT = LidarSpec(noise_m=0.0)


@pytest.fixture
def cross(session):
    opened = []

    def build(plan, ways, **more):
        opened.append(Crossing(session, floor_of(*plan), ways, **more))
        return opened[-1]

    yield build
    for one in reversed(opened):
        one.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plan", "ways", "lidar", "limit_s"),
    [
        # head-on, each from its own room
        ((*ROOMS_AND_CORRIDOR, BAY), [(P(1.2, 2.0), P(10.8, 2.0)), (P(10.8, 2.0), P(1.2, 2.0))], EXACT, 60.0),
        (DOORWAY, [(P(1.5, 2.45), P(6.5, 2.45)), (P(6.5, 2.45), P(1.5, 2.45))], LidarSpec(), 30.0),
        # corridors of 1 m, too narrow for two: each way lies over the start of another robot
        (
            CROSSING,
            [
                (P(1.0, 3.5), P(6.0, 3.5)),
                (P(6.0, 3.5), P(1.0, 3.5)),
                (P(3.5, 1.0), P(3.5, 6.0)),
                (P(3.5, 6.0), P(3.5, 1.0)),
            ],
            LidarSpec(),
            80.0,
        ),
    ],
    ids=["corridor", "doorway", "crossing"],
)
def test_robots_that_meet_pass_without_touching_and_without_a_deadlock(cross, plan, ways, lidar, limit_s):
    one = cross(plan, ways, lidar=lidar)
    one.go()
    took_s = one.run_until_all_arrived(limit_s)
    assert set(one.arrived_s) == set(one.goals), f"after {took_s:.1f} s"
    assert one.collisions == 0
    assert one.deadlock_s <= DEADLOCK_S


@pytest.mark.slow
def test_one_that_stands_idle_in_a_corridor_makes_room(cross):
    one = cross((*ROOMS_AND_CORRIDOR, BAY), [(P(1.2, 2.0), P(10.8, 2.0)), (P(7.0, 2.0), P(7.0, 2.0))], lidar=EXACT)
    one.go("r1")
    one.run_until_all_arrived(60.0, "r1")
    assert "r1" in one.arrived_s
    assert one.collisions == 0


@pytest.mark.slow
def test_a_robot_that_waits_tells_for_whom(cross):
    one = cross((*ROOMS_AND_CORRIDOR, BAY), [(P(1.2, 2.0), P(10.8, 2.0)), (P(10.8, 2.0), P(1.2, 2.0))], lidar=EXACT)
    one.go()
    waits = set()
    one.run(20.0, lambda: waits.update((host.name, host.board.waits_for) for host in one.hosts))
    assert ("r2", "r1") in waits or ("r1", "r2") in waits


def test_a_halted_mate_is_driven_around(cross):
    one = cross(HALL, [(P(1.0, 3.5), P(6.0, 3.5)), (P(6.0, 3.5), P(1.0, 3.5))])
    one.go()
    one.run(2.0)
    one.robot("r2").halting.halt("operator", "test")
    took_s = one.run_until_all_arrived(30.0, "r1")
    assert "r1" in one.arrived_s, took_s
    assert one.collisions == 0


def test_one_that_nobody_hears_of_is_not_run_into(cross):
    """A robot without a host stands in the way: only the lidar knows."""
    one = cross(HALL, [(P(1.0, 3.5), P(6.0, 3.5))], silent=(P(3.5, 3.5),))
    one.go()
    one.run_until_all_arrived(30.0)
    assert one.courier("r1").state is TravelState.ARRIVED
    assert one.collisions == 0
