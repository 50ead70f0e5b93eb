"""Draws fault scripts for the full stack from seeds: on a small floor, with the stock plugins and hardware faults."""

from collections.abc import Iterator
from functools import cache

import msgspec
import numpy as np

from robrain.deploy.soak.shrink import with_sides_of
from robrain.protocol.model.geometry import Point2D
from robrain.sim.faults.fault_spec import COORDINATOR, FaultKind, FaultSpec
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.stand_in.fault_script import CancelOrder, FaultScript, HaltOrder, PointRobot, ScriptRadio, TaskOrder
from robrain.sim.stand_in.script_drawing import draw_script

SCENARIO = "arena_small"
ROBOTS = 3
TASKS = 7
FASTER = 0.6
"""Times of a stand-in's script are shortened to this share: ways are shorter."""
ROOM_M = 0.45
"""Between a drawn place and the nearest wall."""
APART_M = 1.0
"""Between two robots at the start."""
HARDWARE_SHARE = 0.5
"""Share of the scripts with a fault of hardware."""
BROKEN_S = (4.0, 20.0)
RADIO_SHARE = 0.3
"""Share of the scripts whose components hear each other by radio."""
RANGE_M = (12.0, 25.0)
LOSS = (0.0, 0.1)
DELAY_S = (0.0, 0.03)
_RNG_OF_FULL = 17
_RNG_OF_RADIO = 18
_HARDWARE = (
    FaultKind.CAN_CUT,
    FaultKind.CAN_SHORTED,
    FaultKind.MOTORS_FAIL,
    FaultKind.LIDAR_FREEZES,
    FaultKind.MOTE_BASE_FLOODS,
    FaultKind.CARRIED_OFF,
)
KNOWS = "r1"
"""Never killed: an agent that is started again finds its place by the maps of the others."""


def draw_full_script(seed: int) -> FaultScript:
    """The script of a seed: that of the stand-in, made smaller, on a floor with walls.

    An agent's clock is never wrong, as sensors are stamped by the simulator's, and no battery is drained at once, as
    energy would not balance.
    """
    base = draw_script(seed)
    rng = np.random.default_rng([seed, _RNG_OF_FULL])
    robots = _robots(rng, min(ROBOTS, len(base.robots)))
    names = [robot.name for robot in robots]
    tasks = tuple(_task(rng, order) for order in base.tasks[:TASKS])
    ids = {order.task.id for order in tasks}
    return FaultScript(
        seed=seed,
        scenario=SCENARIO,
        robots=robots,
        chargers=_places()[:: len(_places()) - 1],
        method=base.method,
        tasks=tasks,
        cancels=tuple(
            CancelOrder(at_s=_sooner(order.at_s), task=order.task) for order in base.cancels if order.task in ids
        ),
        halts=tuple(HaltOrder(at_s=_sooner(halt.at_s), until_s=_sooner(halt.until_s)) for halt in base.halts),
        faults=(*_faults(base, names), *_hardware(rng, names)),
        radio=_radio(seed),
    )


def _radio(seed: int) -> ScriptRadio | None:
    """A radio that reaches across the floor, for some of the scripts."""
    rng = np.random.default_rng([seed, _RNG_OF_RADIO])
    if rng.random() >= RADIO_SHARE:
        return None
    range_m, loss, delay_s = rng.uniform(*RANGE_M), rng.uniform(*LOSS), rng.uniform(*DELAY_S)
    return ScriptRadio(range_m=round(float(range_m), 1), loss=round(float(loss), 2), delay_s=round(float(delay_s), 3))


def _robots(rng: np.random.Generator, count: int) -> tuple[PointRobot, ...]:
    found: list[PointRobot] = []
    while len(found) < count:
        place = _place(rng)
        if all(place.distance_m(other.place) >= APART_M for other in found):
            soc = round(float(rng.uniform(0.3, 1.0)), 2)
            found.append(PointRobot(name=f"r{len(found) + 1}", place=place, soc=soc))
    return tuple(found)


def _task(rng: np.random.Generator, order: TaskOrder) -> TaskOrder:
    return TaskOrder(at_s=_sooner(order.at_s), task=msgspec.structs.replace(order.task, place=_place(rng)))


def _faults(base: FaultScript, names: list[str]) -> Iterator[FaultSpec]:
    for fault in with_sides_of(base, names):
        is_agent = fault.robot != COORDINATOR
        if fault.kind is FaultKind.DRAIN or (fault.kind is FaultKind.CLOCK_SKEW and is_agent):
            continue
        robot = fault.robot if not is_agent or fault.robot in names else names[-1]
        if fault.kind is FaultKind.KILL and robot == KNOWS:
            robot = names[1]
        at_s = _sooner(fault.at_s)
        until_s = None if fault.until_s is None else max(_sooner(fault.until_s), round(at_s + 0.1, 1))
        yield msgspec.structs.replace(fault, robot=robot, at_s=at_s, until_s=until_s)


def _hardware(rng: np.random.Generator, names: list[str]) -> Iterator[FaultSpec]:
    if rng.random() >= HARDWARE_SHARE:
        return
    kind, robot = FaultKind(str(rng.choice(list(_HARDWARE)))), str(rng.choice(names))
    at_s = round(float(rng.uniform(1.0, 25.0)), 1)
    if kind is FaultKind.CARRIED_OFF:
        place = _place(rng)
        yield FaultSpec(robot=robot, kind=kind, at_s=at_s, place_m=(place.x_m, place.y_m))
    else:
        yield FaultSpec(robot=robot, kind=kind, at_s=at_s, until_s=round(at_s + float(rng.uniform(*BROKEN_S)), 1))


def _sooner(at_s: float) -> float:
    return round(FASTER * at_s, 1)


def _place(rng: np.random.Generator) -> Point2D:
    places = _places()
    return places[int(rng.integers(len(places)))]


@cache
def _places() -> tuple[Point2D, ...]:
    """Places of the floor with room for a robot."""
    plan = Scenario.builtin(SCENARIO).plan()
    rows, columns = np.nonzero(plan.clearance_m[::4, ::4] >= ROOM_M)
    half_m = 0.5 * plan.resolution_m
    return tuple(
        Point2D(
            round(plan.origin_x_m + 4 * int(column) * plan.resolution_m + half_m, 3),
            round(plan.origin_y_m + 4 * int(row) * plan.resolution_m + half_m, 3),
        )
        for row, column in zip(rows, columns, strict=True)
    )
