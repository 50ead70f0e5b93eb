"""What robots are told of their lidar: whether single beams without a return can be believed."""

import msgspec
import pytest

from robrain import Scenario


@pytest.mark.parametrize(("dropout", "told"), [(0.0, {"misses_min": 1}), (0.01, None)])
def test_a_robot_believes_single_beams_only_of_a_lidar_without_dropouts(dropout: float, told: object) -> None:
    scenario = Scenario.builtin("arena_small")
    lidar = msgspec.structs.replace(scenario.hardware.lidar, dropout=dropout)
    world = scenario.replace(hardware=msgspec.structs.replace(scenario.hardware, lidar=lidar)).world()
    assert world.robot_file(world.robots[0]).parameters["mapper"].get("submap") == told
