"""Real-time factor of whole lockstep runs against the bare pymunk loop of the same world."""

import time
from collections.abc import Iterator

import numpy as np
import pymunk

from robrain import Scenario
from robrain.deploy.bench.figure import Figure, timing
from robrain.protocol.model.warm_up import warm_up
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.maps.wall_shapes import add_walls
from robrain.sim.world.arena import TICK_S
from robrain.sim.world.world import World

TEAMS = (1, 4, 16, 64)
SIMULATED_S = 20.0
SPEED_M_S = 0.6


def measure() -> Iterator[Figure]:
    """Two figures for each team size, on the built-in depot with 24 motes, recording digest included."""
    warm_up()
    _whole_run_ms(Scenario.builtin("depot").replace(robots=1).world())
    for robots in TEAMS:
        world = Scenario.builtin("depot").replace(robots=robots).world()
        whole_ms, bare_ms = _whole_run_ms(world), _bare_loop_ms(world)
        team = f"{robots} robot{'s' if robots > 1 else ''}"
        beside = f"{whole_ms:.1f} ms a simulated second; bare pymunk {bare_ms:.2f} ms"
        yield timing(f"{team}: real-time factor of a whole run", 1000.0 / whole_ms, "×", beside=beside)
        yield timing(f"{team}: time of a whole run over that of the bare loop", whole_ms / bare_ms, "×")


def _whole_run_ms(world: World) -> float:
    run = LockstepRun(world)
    try:
        started_s = time.perf_counter()
        for _ in range(round(SIMULATED_S / TICK_S)):
            run.tick()
        return 1000.0 * (time.perf_counter() - started_s) / SIMULATED_S
    finally:
        run.close()


def _bare_loop_ms(world: World) -> float:
    """The same walls and as many round bodies, each with its velocity set anew every tick, and nothing else."""
    space = pymunk.Space()
    add_walls(space, world.plan, collision_type=1)
    rng = np.random.default_rng(0)
    bodies = []
    for robot in world.robots:
        body = pymunk.Body(4.0, 0.08)
        body.position = (robot.start.x_m, robot.start.y_m)
        space.add(body, pymunk.Circle(body, robot.radius_m))
        bodies.append(body)
    headings_rad = rng.uniform(-np.pi, np.pi, len(bodies))
    velocities = [(SPEED_M_S * np.cos(angle), SPEED_M_S * np.sin(angle)) for angle in headings_rad]
    started_s = time.perf_counter()
    for _ in range(round(SIMULATED_S / TICK_S)):
        for body, velocity in zip(bodies, velocities, strict=True):
            body.velocity = velocity
        space.step(TICK_S)
    return 1000.0 * (time.perf_counter() - started_s) / SIMULATED_S
