"""Whole robots of robrain beside the bare simulation of ir-sim, and the speed of robots that are points.

ir-sim (Han, https://github.com/hanruihua/ir-sim) moves round robots and their lidars; it has no plugins, no wire, no
mapping and no planning. It steps once a lidar turn, where the arena takes ten steps of physics.
"""

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import numpy as np

from robrain import Scenario
from robrain.algorithms.allocation.allocator import OPTIMAL
from robrain.algorithms.warm_up import warm_up
from robrain.coordinator.planning.policy import NEAREST
from robrain.lab.bench.figure import Bound, Figure, at_least, timing
from robrain.lab.soak.fault_script import FaultScript, ScriptRobot, TaskInput
from robrain.lab.soak.soak_run import SIDE_M, SoakRun, quiet
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import VISIT
from robrain.protocol.model.tasks.task import Task
from tests.bench.real_time_factor import whole_run_ms

TEAMS = (10, 100)
STEPS = {10: 100, 100: 15}
"""Steps of ir-sim that are timed."""
TURN_S = 0.2
"""A turn of the lidar, which is ir-sim's step."""

WORLD = {
    "width": 36,
    "height": 24,
    "step_time": TURN_S,
    "sample_time": TURN_S,
    "collision_mode": "unobstructed",
    "control_mode": "auto",
}
INSIDE = {"range_low": [1, 1, -3.14], "range_high": [35, 23, 3.14]}
LIDAR = {"type": "lidar2d", "range_min": 0, "range_max": 6, "angle_range": 6.28318, "number": 180}
ROBOTS = {
    "kinematics": {"name": "omni"},
    "distribution": {"name": "random", **INSIDE},
    "shape": {"name": "circle", "radius": 0.2},
    "vel_max": [0.6, 0.6],
    "behavior": {"name": "dash", "wander": True, **INSIDE},
    "sensors": [LIDAR],
}
SHELVES = {
    "number": 20,
    "distribution": {"name": "random", "range_low": [2, 2, -3.14], "range_high": [34, 22, 3.14]},
    "shape": [{"name": "rectangle", "length": 2, "width": 0.5}],
}
SCRIPT = """
import sys, time
import irsim
env = irsim.make(sys.argv[1], display=False, log_level="ERROR")
env.step()
began_s = time.perf_counter()
for _ in range(int(sys.argv[2])):
    env.step()
print("seconds", time.perf_counter() - began_s)
"""


POINTS, TASKS, POINTS_S = 8, 50, 60.0
POINTS_SPEED = at_least(3000.0)


def measure() -> Iterator[Figure]:
    """Three figures for each team size, and the speed of points with less and less to do."""
    warm_up()
    script = _script()
    idle = msgspec.structs.replace(script, tasks=())
    yield _speed(f"{TASKS} tasks", script, POINTS_SPEED)
    yield _speed(f"{TASKS} tasks, each to the nearest robot", msgspec.structs.replace(script, method=NEAREST))
    yield _speed("no tasks", idle)
    yield _speed("no coordinator", idle, has_coordinator=False)
    for robots in TEAMS:
        whole_ms, _ = whole_run_ms(Scenario.builtin("depot").replace(robots=robots).world(), simulated_s=200.0 / robots)
        bare_ms = _peer_ms(robots)
        team = f"{robots} robots with lidar"
        yield timing(f"{team}: real-time factor of ir-sim, simulation alone", 1000.0 / bare_ms, "×")
        yield timing(f"{team}: real-time factor of robrain, whole stack", 1000.0 / whole_ms, "×")
        yield timing(f"{team}: robrain's factor over ir-sim's", bare_ms / whole_ms, "×")


def _script() -> FaultScript:
    rng = np.random.default_rng(1)
    places = np.round(rng.uniform(1.0, SIDE_M - 1.0, (TASKS, 2)), 1).tolist()
    return FaultScript(
        seed=1,
        robots=tuple(
            ScriptRobot(name=f"r{number + 1}", place=Point2D(2.0 + 2.0 * number, 3.0)) for number in range(POINTS)
        ),
        method=OPTIMAL,
        tasks=tuple(
            TaskInput(at_s=0.5, task=Task(id=f"t{number}", kind=VISIT, place=Point2D(*place), service_s=2.0))
            for number, place in enumerate(places)
        ),
    )


def _speed(what: str, script: FaultScript, bound: Bound | None = None, *, has_coordinator: bool = True) -> Figure:
    """Simulated robot-seconds a CPU second."""
    with quiet(), closing(SoakRun(script)) as run:
        run.tick()
        if not has_coordinator:
            run.end_coordinator()
        begun_s = time.process_time()
        while run.sim_time_s < POINTS_S:
            run.tick()
        speed = POINTS * POINTS_S / (time.process_time() - begun_s)
    return timing(f"points, {POINTS} robots, {what}: robot-seconds in a CPU second", speed, "", bound)


def _peer_ms(robots: int) -> float:
    """Milliseconds of ir-sim for each simulated second, in a process of its own: it changes matplotlib's settings."""
    world = {"world": WORLD, "robot": [{"number": robots, **ROBOTS}], "obstacle": [SHELVES]}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "world.yaml"
        path.write_bytes(msgspec.json.encode(world))  # JSON is YAML
        command = [sys.executable, "-c", SCRIPT, str(path), str(STEPS[robots])]
        said = subprocess.run(command, capture_output=True, text=True, check=True, cwd=folder).stdout
    seconds = next(float(line.split()[1]) for line in said.splitlines() if line.startswith("seconds "))
    return 1000.0 * seconds / (STEPS[robots] * TURN_S)
