"""A run of a fault script with robots that are points, in a hall whose map they have."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.agent.host.agent_host import AgentHost
from robrain.algorithms.exploration.strategies import NO_EXPLORATION
from robrain.coordinator.coordinator import Coordinator
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.lab.soak.fault_script import FaultScript
from robrain.lab.soak.operator import OPERATOR, Operator
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.links.exchange import EVERYWHERE
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.sim.faults.fault_spec import FaultSpec
from robrain.sim.faults.process import Process
from robrain.sim.firmware.battery import J_PER_WH, BatterySpec
from robrain.sim.firmware.power_model import PowerModel
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.points.point_team import PointRobot
from robrain.sim.robot.robot_hardware import RobotHardware
from robrain.sim.world.chargers import ChargerSpec
from robrain.sim.world.robot_specs import RobotSpec
from robrain.sim.world.world import Fidelity, World, build_world

SIDE_M = 20.0
"""Robots start, and tasks lie, from 0 to this along both axes."""
MARGIN_M = 1.0
"""Between that square and the walls of the hall."""
CELL_M = 0.1
ROOM_M = 4.0
"""Side of the rooms of a divided hall."""
DOOR_M = 0.9
FREE_M = 0.7
"""No wall of a divided hall is nearer to a start, a task or a charger."""
CAPACITY_J = 8000.0
SPEED_M_S = 1.0
CHARGING_W = 200.0
POWER = PowerModel(idle_w=2.0, compute_w=6.0, moving_w=0.0, speed_w_per_m_s=12.0)
"""8 W standing, 20 W at `SPEED_M_S`."""
WITHOUT = ("camera", "mote_base", "sensor_board")
"""Plugins that robots of a soak lack, with plugins that require them."""
PLUGINS: dict[str, dict[str, Any]] = {"mapper": {"known": True}, "driver": {"speed_m_s": SPEED_M_S}}


def world_of(script: FaultScript, faults: tuple[FaultSpec, ...] = ()) -> World:
    """The world of a script.

    Args:
        script: robots, chargers and faults.
        faults: further faults.

    """
    side = round((SIDE_M + 2.0 * MARGIN_M) / CELL_M)
    walls = _walls(script, side) if script.is_divided else np.zeros((side, side), np.bool_)
    plan = FloorPlan(walls, CELL_M, -MARGIN_M, -MARGIN_M, "hall")
    robots = [
        RobotSpec(
            near_m=(robot.place.x_m, robot.place.y_m),
            hardware={"battery": {"soc_at_start": robot.soc}},
            without=WITHOUT,
            plugins=PLUGINS,
        )
        for robot in script.robots
    ]
    hardware = RobotHardware(
        battery=BatterySpec(capacity_wh=CAPACITY_J / J_PER_WH), power=POWER, consensus=script.consensus
    )
    chargers = tuple(ChargerSpec(place_m=(place.x_m, place.y_m), power_w=CHARGING_W) for place in script.chargers)
    world = build_world(plan, len(robots), 0, None, script.seed, hardware, chargers=chargers, specs=robots)
    named = zip(world.robots, script.robots, strict=True)
    return replace(
        world,
        robots=[msgspec.structs.replace(robot, name=drawn.name) for robot, drawn in named],
        faults=(*script.faults, *faults),
        idle=True,
        fidelity=Fidelity.POINTS,
    )


def _walls(script: FaultScript, side: int) -> NDArray[np.bool_]:
    """(side, side) solid cells: rooms, with a door for one robot in each wall between two of them."""
    walls = np.zeros((side, side), np.bool_)
    rng = np.random.default_rng([script.seed, side])
    room, door = round(ROOM_M / CELL_M), round(DOOR_M / CELL_M)
    for line in range(room, side - 1, room):
        walls[line : line + 2] = walls[:, line : line + 2] = True
    for line in range(room, side - 1, room):
        for begin in range(0, side, room):
            for lines in (walls, walls.T):
                at = begin + 3 + int(rng.integers(max(1, min(room, side - begin) - door - 4)))
                lines[line : line + 2, at : at + door] = False
    rows, columns = np.indices(walls.shape)
    places = [task.task.place for task in script.tasks] + [robot.place for robot in script.robots]
    for place in (*places, *script.chargers):
        x_m, y_m = (columns + 0.5) * CELL_M - MARGIN_M - place.x_m, (rows + 0.5) * CELL_M - MARGIN_M - place.y_m
        walls &= x_m**2 + y_m**2 > FREE_M**2
    return walls


class SoakRun(LockstepRun):
    """One run, tick by tick.

    Args:
        script: the team, its orders, and its faults.
        faults: further faults.

    """

    def __init__(self, script: FaultScript, faults: tuple[FaultSpec, ...] = ()) -> None:
        self.script = script
        policy = PlanningPolicy(method=script.method, exploration=NO_EXPLORATION)
        super().__init__(world_of(script, faults), planning=policy, processes=True)
        robots = [self.arena.robot(robot.name) for robot in script.robots]
        self.robots = {robot.name: robot for robot in robots if isinstance(robot, PointRobot)}
        """By name."""
        self.processes = self.team_faults.processes
        """By component."""
        self.wire = self.wire_of()
        """An endpoint that no fault touches."""
        self.operator = Operator(self.wire_of(party=OPERATOR), script)

    @property
    def leader(self) -> Coordinator | None:
        """The coordinator that runs; None while it is dead."""
        return self.team_faults.coordinator

    @property
    def now_ns(self) -> int:
        """Time since the start."""
        return self.clock.now_ns()

    def host(self, robot: str) -> AgentHost | None:
        """The agent of a robot; None while it is dead."""
        found = self.processes[robot].component
        return found if isinstance(found, AgentHost) else None

    def work(self, robot: str) -> str:
        """Id of the task that a robot is at; empty if it is at none."""
        host = self.host(robot)
        if host is None or not self.processes[robot].is_awake or host.manager.halted:
            return ""
        status = host.desk.facts.task
        return "" if status is None or status.state.ended else status.id

    def is_linked(self, one: str, other: str) -> bool:
        """Whether no cut is between two components."""
        return self.team_faults.wire.reaches(one, other)

    def tick(self) -> None:
        """Move the run on; the operator acts last."""
        super().tick()
        self.operator.step(self.now_ns)

    def wire_of(self, process: Process | None = None, party: str = EVERYWHERE) -> Endpoint:
        """An endpoint of a process, or one of another party by the run's clock."""
        if process is not None:
            return Endpoint(self.session, DEFAULT_TEAM, process.clock, Drive.LOCKSTEP, party=process.name)
        return Endpoint(self.session, DEFAULT_TEAM, self.clock, Drive.LOCKSTEP, party=party)


@contextmanager
def quiet() -> Iterator[None]:
    """Without the warnings that the product logs of each fault."""
    before = logging.root.manager.disable
    logging.disable(logging.ERROR)
    try:
        yield
    finally:
        logging.disable(before)
