"""Real-time factor of whole lockstep runs, beside a loop that tells how fast the machine is at the moment."""

import math
import time
from collections.abc import Iterator

import numpy as np
import pymunk

from robrain import Scenario
from robrain.algorithms.warm_up import warm_up
from robrain.lab.bench.figure import Figure, at_least, at_most, timing
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.maps.wall_shapes import add_walls
from robrain.sim.world.world import TICK_S, World

TEAMS = {1: 120.0, 4: 45.0, 16: 12.0, 64: 2.5}
"""Robots, and the least real-time factor."""
CPU_RATIO_MAX = 1.5
"""CPU time of one robot in the largest team over that of one alone."""
SIMULATED_S = 20.0
SPEED_M_S = 0.6


def measure() -> Iterator[Figure]:
    """Three figures for each team size, on the built-in depot with 24 motes, recording digest included."""
    warm_up()
    yield timing("calibration: a turn of a loop in plain Python", calibration_ns(), "ns")
    whole_run_ms(Scenario.builtin("depot").replace(robots=1).world())
    cpu_ms = {}
    for robots, least in TEAMS.items():
        world = Scenario.builtin("depot").replace(robots=robots).world()
        whole_ms, team_ms = whole_run_ms(world)
        cpu_ms[robots] = team_ms / robots
        bare_ms = _bare_loop_ms(world)
        team = f"{robots} robot{'s' if robots > 1 else ''}"
        beside = f"{whole_ms:.1f} ms a simulated second; bare pymunk {bare_ms:.2f} ms"
        yield timing(f"{team}: real-time factor of a whole run", 1000.0 / whole_ms, "×", at_least(least), beside)
        yield timing(f"{team}: CPU time of one robot", cpu_ms[robots], "ms/sim s")
        yield timing(f"{team}: time of a whole run over that of the bare loop", whole_ms / bare_ms, "×")
    most = max(TEAMS)
    ratio = cpu_ms[most] / cpu_ms[1]
    yield timing(f"CPU time of one robot among {most} over that of one alone", ratio, "×", at_most(CPU_RATIO_MAX))


def calibration_ns(turns: int = 1_000_000) -> float:
    """Nanoseconds of one turn of a loop with a little arithmetic: the best of five."""
    best_s = math.inf
    for _ in range(5):
        began_s, total = time.perf_counter(), 0.0
        for number in range(turns):
            total += number * 0.5 - total * 1e-9
        best_s = min(best_s, time.perf_counter() - began_s)
    return best_s / turns * 1e9


def whole_run_ms(world: World, *, simulated_s: float = SIMULATED_S) -> tuple[float, float]:
    """Milliseconds of a whole run for each simulated second, by the wall and of CPU time; set-up not counted."""
    run = LockstepRun(world)
    try:
        started_s, cpu_s = time.perf_counter(), time.process_time()
        for _ in range(round(simulated_s / TICK_S)):
            run.tick()
        spent_s = time.perf_counter() - started_s, time.process_time() - cpu_s
        return 1000.0 * spent_s[0] / simulated_s, 1000.0 * spent_s[1] / simulated_s
    finally:
        run.close()


def _bare_loop_ms(world: World) -> float:
    """The same walls and as many round bodies, each with its velocity set again every tick, and nothing else."""
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
