"""A simulated robot, a file of it that is wrong, and bring-up of the two."""

from pathlib import Path
from typing import Any

import msgspec

from robrain import Scenario
from robrain.deploy.bringup.bring_up import BringUp, BringUpOptions, patched
from robrain.deploy.bringup.findings import BringUpReport, CheckFinding, FindingKind, Operator
from robrain.sim.world.robot_specs import RobotSpec, RobotType
from robrain.sim.world.world import World
from tests.deploy.bringup.lockstep_bench import LockstepBench

AIR, FLOOR = BringUpOptions(floor=False), BringUpOptions(air=False)
NO_SQUARES = BringUpOptions(air=False, rounds=0)
YARD = """
[scenario]
name = "yard"

[floor]
size_m = [7.0, 6.0]
blocks = [
    { x_m = 0.0, y_m = 4.6, width_m = 1.2, height_m = 0.6 },
    { x_m = 6.0, y_m = 0.5, width_m = 0.7, height_m = 1.3 },
]

[motes]
count = 0

[team]
robots = 1
"""
"""A floor with room for squares around `PLACE_M`."""
PLACE_M = (3.0, 3.0)
LEFT: dict[str, Any] = {"frame": "LeftEncoder", "signals": ["left_counts"]}
RIGHT: dict[str, Any] = {"frame": "RightEncoder", "signals": ["right_counts"]}
IMU = {"bias_rad_s": 0.05, "noise_rad_s": 0.005}


class BroughtUp:
    """One robot and its file, brought up as often as wanted.

    Args:
        folder: for the file.
        patch: by plugin, what the file says wrongly.
        hardware: what the robot is built like.
        type: of the robot.
        lidar_known: whether the file says how the lidar is mounted.

    """

    def __init__(
        self,
        folder: Path,
        patch: dict[str, dict[str, Any]],
        hardware: dict[str, Any] | None = None,
        type: RobotType = RobotType.TWO_WHEELS,
        *,
        lidar_known: bool = False,
    ) -> None:
        spec = RobotSpec(type=type, hardware=hardware or {}, place_m=PLACE_M)
        self.world: World = Scenario.from_toml(YARD).replace(roster=(spec,), seed=3).world()
        robot_file = self.world.robot_file(self.world.robots[0])
        parameters = dict(robot_file.parameters)
        if "scan" in parameters and not lidar_known:
            parameters["scan"] = {key: value for key, value in parameters["scan"].items() if key != "mount"}
        robot_file = msgspec.structs.replace(robot_file, parameters=patched(parameters, patch))
        self.path = folder / "r1.toml"
        self.path.write_bytes(b"# hers\n" + msgspec.toml.encode(robot_file))
        self.told: list[CheckFinding] = []

    def run(self, wanted: BringUpOptions, operator: Operator | None = None) -> BringUpReport:
        with LockstepBench(self.world) as bench:
            return BringUp(self.path, bench, operator or Operator(), self.told.append).run(wanted)


def wrong(report: BringUpReport) -> set[FindingKind]:
    """What was not as it should be."""
    return {finding.found for finding in report.findings if finding.ok is False}


def value(report: BringUpReport, found: FindingKind, name: str) -> float:
    """A figure of the first finding of a kind."""
    return next(finding.values[name] for finding in report.findings if finding.found is found)
