"""Several robots and several chargers: nobody waits at one that is taken while another is free, nobody is stranded."""

from collections.abc import Callable, Iterator

import pytest

from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.sim.firmware.battery import BatterySpec
from tests.plugins.behavior.errands import CHARGER, Errands

pytestmark = pytest.mark.slow

DOCKS = (CHARGER, Point2D(0.8, 3.2), Point2D(5.2, 3.2), Point2D(5.2, 0.8), Point2D(2.4, 3.3))
SMALL_WH = 1.5
ROBOTS = ("r1", "r2")


@pytest.fixture
def team() -> Iterator[Callable[..., Errands]]:
    opened: list[Errands] = []

    def build(robots: int, docks: int, soc: float) -> Errands:
        starts = {"r2": Pose2D(2.4, 1.0, 0.0), "r3": Pose2D(2.4, 2.2, 0.0)}
        known = [{"x_m": dock.x_m, "y_m": dock.y_m} for dock in DOCKS[:docks]]
        opened.append(
            Errands(
                *("recharge", "visit", "explore"),
                starts={name: starts[name] for name in [*starts][: robots - 1]},
                parameters={"home": {"chargers": known}, "battery": {"capacity_wh": SMALL_WH}},
                hardware={"battery": BatterySpec(capacity_wh=SMALL_WH, soc_at_start=soc)},
                docks=DOCKS[:docks],
            )
        )
        return opened[-1]

    yield build
    for one in opened:
        one.close()


def charging(run: Errands) -> set[int]:
    return {robot for robot in run.arena.chargers.docked if robot is not None}


def test_more_robots_than_chargers_take_turns_and_none_is_stranded(team):
    run = team(2, 1, 0.3)
    charged: set[int] = set()
    for _ in range(160):
        run.run(2.0)
        charged |= charging(run)
        assert not any(run.is_cut_off(robot) for robot in ROBOTS)
        if charged == {0, 1}:
            break
    assert charged == {0, 1}
    assert run.arena.collisions == 0
