"""One robot at a time is in a reserved zone, by the ground truth, without a coordinator and with lost messages."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import pytest

from robrain.algorithms.exploration.strategies import NO_EXPLORATION
from robrain.algorithms.navigation.reservations import distance_m
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.lab.bench.traffic import RADIUS_M, Courier, CourierWorld, TrafficFloor, _world, floor_of
from robrain.protocol.model.zone import ZoneKind, ZoneTable
from robrain.recording.invariants.judging import Judging
from robrain.recording.invariants.zone_invariants import ZonesObeyed
from robrain.sim.faults.fault_spec import COORDINATOR, FaultKind, FaultSpec
from robrain.sim.lockstep.lockstep import LockstepRun

LANE = floor_of(15.0, 6.0, (0.3, 0.3, 6.0, 5.7), (9.0, 0.3, 14.7, 5.7), (6.0, 2.5, 9.0, 3.5))
"""Two halls, joined by a lane for one robot."""
NO_COORDINATOR = FaultSpec(robot=COORDINATOR, kind=FaultKind.KILL, at_s=1.0)


def box(name: str, x0: float, y0: float, x1: float, y1: float) -> ZoneTable:
    return ZoneTable(name=name, kind=ZoneKind.RESERVED, corners_m=((x0, y0), (x1, y0), (x1, y1), (x0, y1)))


IN_LANE = box("lane", 6.0, 2.4, 9.0, 3.6)


def sides(robots: int) -> list[list[tuple[float, float]]]:
    """Robots that go from side to side, half of them from each."""
    left = [(1.0 + number % 2 * 1.2, 0.9 + 1.1 * (number // 2)) for number in range(robots)]
    trips = [[(15.0 - x_m, y_m), (x_m, y_m)] for x_m, y_m in left]
    return [trip if number % 2 else trip[::-1] for number, trip in enumerate(trips)]


class ZoneRun:
    """A run of couriers, and the most robots that any zone has held, by their hulls."""

    def __init__(self, world: CourierWorld, zones: Sequence[ZoneTable]) -> None:
        self.run = LockstepRun(world, planning=PlanningPolicy(exploration=NO_EXPLORATION, zones=zones), processes=True)
        self._zones, self.most = zones, 0
        self.judging = Judging(judges=(ZonesObeyed,))
        self.run.follow(self.judging.receive)

    def until(self, time_s: float) -> None:
        while self.run.sim_time_s < time_s:
            self.run.tick()
            places = np.array([(body.x_m, body.y_m) for body in self.run.arena.bodies])
            inside = [int((distance_m(zone, places) < RADIUS_M).sum()) for zone in self._zones]
            self.most = max(self.most, *inside)

    def courier(self, robot: str) -> Courier:
        [host] = [host for host in self.run.hosts if host.name == robot]
        courier = host.manager.get("courier").plugin
        assert isinstance(courier, Courier)
        return courier


@contextmanager
def running(
    rounds: list[list[tuple[float, float]]], zones: Sequence[ZoneTable], *faults: FaultSpec
) -> Iterator[ZoneRun]:
    zone_run = ZoneRun(_world(TrafficFloor(LANE, rounds), 0, faults), zones)
    try:
        yield zone_run
    finally:
        zone_run.run.close()


@pytest.mark.slow
@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_robots_pass_a_lane_one_at_a_time_without_a_coordinator(loss: float) -> None:
    lost = [FaultSpec(robot=f"r{n}", kind=FaultKind.LOSE, at_s=1.0, share=loss) for n in range(1, 7) if loss]
    with running(sides(6), [IN_LANE], NO_COORDINATOR, *lost) as zone_run:
        waits = set()
        for time_s in range(1, 150):
            zone_run.until(time_s)
            waits |= {(host.board.waits_at, bool(host.board.waits_for)) for host in zone_run.run.hosts}
        assert zone_run.most == 1
        assert ("lane", True) in waits
        assert all(zone_run.courier(f"r{number}").trips >= 1 for number in range(1, 7))
        assert zone_run.run.arena.collisions == 0
        [ruling] = zone_run.judging.finish()
        assert ruling.breaches == []


@pytest.mark.slow
def test_robots_in_two_zones_that_touch_do_not_wait_for_each_other() -> None:
    zones = [box("one", 6.0, 2.4, 7.5, 3.6), box("two", 7.5, 2.4, 9.0, 3.6)]
    with running(sides(4), zones, NO_COORDINATOR) as zone_run:
        zone_run.until(120.0)
        assert zone_run.most == 1
        assert all(zone_run.courier(f"r{number}").trips >= 1 for number in range(1, 5))


@pytest.mark.slow
def test_a_robot_that_falls_silent_inside_keeps_the_zone_until_it_is_back() -> None:
    rounds = [[(7.5, 3.0)], [(12.0, 1.0), (2.0, 1.0)], [(12.0, 4.0), (2.0, 4.0)]]
    dies = FaultSpec(robot="r1", kind=FaultKind.KILL, at_s=8.0, until_s=90.0)
    with running(rounds, [IN_LANE], dies) as zone_run:
        zone_run.until(85.0)  # longer than robots remember silent ones without a request
        hosts = {host.name: host.board for host in zone_run.run.hosts}
        assert ("r1", "lane") in {(board.waits_for, board.waits_at) for board in hosts.values()}
        zone_run.until(110.0)
        assert zone_run.most == 1


@pytest.mark.slow
def test_an_idle_robot_leaves_a_zone_for_which_others_wait() -> None:
    rounds = [[(7.5, 3.0)], [(12.0, 1.0), (2.0, 1.0)], [(12.0, 4.0), (2.0, 4.0)]]
    world = _world(TrafficFloor(LANE, rounds), 0, ())
    world.rounds[0] = []
    zone_run = ZoneRun(world, [IN_LANE])
    try:
        zone_run.until(60.0)
        assert zone_run.most == 1
        assert [zone_run.courier(name).trips > 1 for name in ("r2", "r3")] == [True, True]
    finally:
        zone_run.run.close()
