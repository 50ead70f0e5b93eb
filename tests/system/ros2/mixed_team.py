"""Live teams on one floor: stock robots, robots with a differential base and an LD19 on a pty, and ROS 2 nodes.

Robots of the arena and ROS 2 nodes do not meet: each node has a world of its own with the same walls.
"""

import tomllib
from collections.abc import Sequence
from contextlib import ExitStack
from enum import StrEnum
from pathlib import Path
from typing import Any, Self

from robrain.recording.provenance import MAP_ATTACHMENT
from robrain.sim.scenarios.scenario import Scenario
from tests.ros_domain import Domain
from tests.system.conftest import Commands

LOAD = ("explore", "visit", "battery", "energy", "recharge", "command")


class Kind(StrEnum):
    """What a robot is."""

    STOCK = "stock"
    DESCRIBED = "described"
    """A differential base by a DBC file, and an LD19 on a pty."""
    ROS2 = "ros2"


SPECS = {Kind.STOCK: "", Kind.DESCRIBED: 'type = "two_wheels"\n[robots.hardware.lidar]\nprotocol = "ld19"\n'}


class MixedTeam:
    """The team's processes; `r1`, `r2`, … in the order of `kinds`.

    Args:
        commands: starts them, and ends them.
        domain: of the robots that speak ROS 2.
        floor: the scenario's floor: its tables `[floor]` or `[map]`, and what else there is but robots.
        places: where the robots start, arena frame, looking along x.
        kinds: what each of them is.

    """

    def __init__(
        self,
        commands: Commands,
        domain: Domain,
        floor: str,
        places: Sequence[tuple[float, float]],
        kinds: Sequence[Kind],
    ) -> None:
        self.endpoint = ""
        self._commands, self._domain, self._floor = commands, domain, floor
        self._places, self._kinds = places, kinds
        self._closing = ExitStack()

    def __enter__(self) -> Self:
        commands, folder = self._commands, self._commands.folder / "robots"
        simulated = [number for number, kind in enumerate(self._kinds) if kind is not Kind.ROS2]
        # A robot of the arena that nobody drives stands in a corner of it, where there is none to simulate.
        shown = simulated or [0]
        robots = "".join(
            f"[[robots]]\nplace_m = {list(self._places[number])}\n{SPECS.get(self._kinds[number], '')}"
            for number in shown
        )
        head = f'[scenario]\nname = "mixed"\n{self._floor}\n[team]\nrobots = {len(shown)}\n'
        (commands.folder / "mixed.toml").write_text(head + robots)
        arena = commands.start("arena", "mixed.toml", "--listen", "tcp/127.0.0.1:0", "--robot-files", "robots")
        self.endpoint = commands.line_with(arena, "arena: mixed at ").split(" at ")[1].split(",")[0]
        coordinator = commands.start("coordinator", "--connect", self.endpoint)
        commands.line_with(coordinator, "coordinator: of team default")
        grid = tomllib.loads((folder / "r1.toml").read_text())["parameters"]["mapper"]
        for number, kind in enumerate(self._kinds):
            name = f"r{number + 1}"
            if kind is Kind.ROS2:
                self._start_node(name, number, grid)
            where = self._domain.variables if kind is Kind.ROS2 else {}
            agent = commands.start("agent", f"robots/{name}.toml", "--connect", self.endpoint, **where)
            commands.line_with(agent, f"agent: {name} is up with")
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.close()

    def _start_node(self, name: str, number: int, grid: dict[str, Any]) -> None:
        import tomli_w

        from tests.system.ros2.ros_robot import ROLES, RosRobot

        x_m, y_m = self._places[number]
        robot: RosRobot = RosRobot(self._draw(), self._domain, namespace=f"/{name}", x=x_m, y=y_m, yaw=0.0)
        self._closing.callback(robot.kill)
        robot.start()
        parameters = {
            **{role: {"namespace": f"/{name}"} for role in ROLES},
            "localisation": {"x_m": x_m, "y_m": y_m, "yaw_rad": 0.0},
            "mapper": grid,
        }
        table = {"name": name, "load": list(LOAD), "roles": dict(ROLES)}
        path = self._commands.folder / "robots" / f"{name}.toml"
        path.write_text(tomli_w.dumps({"robot": table, "parameters": parameters}))

    def _draw(self) -> Path:
        """The floor in the format of map_server."""
        folder: Path = self._commands.folder
        if not (folder / "floor.yaml").exists():
            world = Scenario.from_file(folder / "mixed.toml").world()
            (folder / MAP_ATTACHMENT).write_bytes(world.map_png())
            (folder / "floor.yaml").write_text(world.map_yaml())
        return folder / "floor.yaml"
