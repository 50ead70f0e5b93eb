"""Draws fault scripts from seeds."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from robrain.algorithms.allocation.allocator import AUCTION, OPTIMAL
from robrain.coordinator.planning.policy import NEAREST
from robrain.lab.soak.fault_script import CancelOrder, FaultScript, HaltOrder, ScriptRobot, TaskInput
from robrain.lab.soak.soak_run import SIDE_M
from robrain.protocol.clock import to_ns
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import VISIT
from robrain.protocol.model.tasks.task import Task
from robrain.sim.faults.fault_spec import COORDINATOR, FaultKind, FaultMoment, FaultSpec

SPAN_S = 40.0
"""Orders and faults begin within this time."""
METHODS = {NEAREST: 0.6, AUCTION: 0.37, OPTIMAL: 0.03}
"""Share of the scripts that each method gets; an optimal plan is slower than all others."""
CONSENSUS_SHARE = 0.2
"""Share of the scripts whose robots continue without a coordinator; it is away for a while in each of them."""
DIVIDED_SHARE = 0.3
"""Share of the scripts whose hall has walls with narrow doors."""
_RNG_OF_SCRIPTS, _RNG_OF_ABSENCES, _RNG_OF_WALLS = 13, 14, 19

Draw = Callable[[np.random.Generator, str, float], FaultSpec]
_SHARES = [0.28, 0.12, 0.06, 0.05, 0.05, 0.05, 0.12, 0.08, 0.05, 0.14]


def draw_script(seed: int) -> FaultScript:
    """The script of a seed: two to five robots, six to fourteen tasks, up to eight faults."""
    rng = np.random.default_rng([seed, _RNG_OF_SCRIPTS])
    names = [f"r{number}" for number in range(1, int(rng.integers(2, 6)) + 1)]
    robots = tuple(
        ScriptRobot(name=name, place=_place(rng), soc=round(float(rng.uniform(0.3, 1.0)), 2)) for name in names
    )
    tasks = _tasks(rng)
    children = {name for order in tasks for name in order.task.after}
    cancels = tuple(
        CancelOrder(at_s=_time(rng, order.at_s, SPAN_S + 10.0), task=order.task.id)
        for order in tasks
        if order.task.deadline_ns is None and rng.random() < (0.03 if order.task.id in children else 0.12)
    )
    halts: tuple[HaltOrder, ...] = ()
    if rng.random() < 0.35:
        at_s = _time(rng, 2.0, SPAN_S)
        halts = (HaltOrder(at_s=at_s, until_s=round(at_s + float(rng.uniform(2.0, 25.0)), 1)),)
    absence = _absence(seed, names)
    # A coordinator waits ten minutes for robots that may allocate tasks among themselves, longer than a script lasts.
    killed_max = len(names) - 1 if absence is None else (len(names) - 1) // 2
    faults = (*_faults(rng, names, killed_max), *_around_halts(rng, names, halts))
    return FaultScript(
        seed=seed,
        robots=robots,
        chargers=(Point2D(0.0, 0.0), Point2D(SIDE_M, SIDE_M)),
        method=str(rng.choice(list(METHODS), p=list(METHODS.values()))),
        tasks=tasks,
        cancels=cancels,
        halts=halts,
        consensus=absence is not None,
        is_divided=bool(np.random.default_rng([seed, _RNG_OF_WALLS]).random() < DIVIDED_SHARE),
        faults=faults if absence is None else (*faults, absence),
    )


def _absence(seed: int, names: list[str]) -> FaultSpec | None:
    """A time without the coordinator, or with few of the robots in its reach; None if the script has no consensus.

    Long enough for robots to allocate tasks.

    It uses a separate generator, so that the rest of a seed's script does not depend on it.
    """
    rng = np.random.default_rng([seed, _RNG_OF_ABSENCES])
    if rng.random() >= CONSENSUS_SHARE:
        return None
    kind = FaultKind.KILL if rng.random() < 0.7 else FaultKind.PARTITION
    at_s = 0.0 if rng.random() < 0.2 else _time(rng, 0.0, SPAN_S)
    until_s = round(at_s + float(rng.uniform(3.0, 60.0)), 1)
    side: tuple[str, ...] = ()
    if kind is FaultKind.PARTITION and len(names) > 2 and rng.random() < 0.7:
        side = tuple(sorted(rng.choice(names, size=int(rng.integers(1, len(names))), replace=False).tolist()))
    return FaultSpec(robot=COORDINATOR, kind=kind, at_s=at_s, until_s=until_s, side=side)


def _tasks(rng: np.random.Generator) -> tuple[TaskInput, ...]:
    orders: list[TaskInput] = []
    for number in range(1, int(rng.integers(7, 16))):
        at_s = 0.5 if rng.random() < 0.4 else _time(rng, 0.5, SPAN_S)
        earlier = [order.task.id for order in orders if order.at_s <= at_s and order.task.deadline_ns is None]
        after = tuple(rng.choice(earlier, size=1).tolist()) if earlier and rng.random() < 0.2 else ()
        deadline_s = at_s + float(rng.uniform(60.0, 200.0)) if rng.random() < 0.1 else None
        earliest_s = at_s + float(rng.uniform(0.0, 30.0)) if rng.random() < 0.1 else 0.0
        task = Task(
            id=f"t{number}",
            kind=VISIT,
            place=_place(rng),
            priority=float(rng.choice([1.0, 1.0, 2.0, 5.0])),
            service_s=round(float(rng.uniform(0.0, 6.0)), 1),
            earliest_ns=to_ns(round(earliest_s, 1)),
            deadline_ns=None if deadline_s is None else to_ns(round(deadline_s, 1)),
            after=after,
        )
        orders.append(TaskInput(at_s=at_s, task=task))
    return tuple(orders)


def _faults(rng: np.random.Generator, names: list[str], killed_max: int) -> Iterator[FaultSpec]:
    killed_for_good = 0
    for _ in range(int(rng.integers(1, 9))):
        kind = str(rng.choice(list(_KINDS), p=_SHARES))
        target = COORDINATOR if rng.random() < 0.35 else str(rng.choice(names))
        at_s = _time(rng, 0.0, SPAN_S)
        fault = _KINDS[kind](rng, target, at_s)
        may_be_killed = killed_for_good < killed_max and target == names[killed_for_good]
        if fault.kind is FaultKind.KILL and may_be_killed and rng.random() < 0.3:
            killed_for_good += 1
            fault = FaultSpec(robot=target, kind=FaultKind.KILL, at_s=at_s)
        yield fault


def _around_halts(rng: np.random.Generator, names: list[str], halts: tuple[HaltOrder, ...]) -> Iterator[FaultSpec]:
    """Faults that keep a component from receiving a halt when it is published."""
    for halt in halts:
        if rng.random() < 0.6:
            target = COORDINATOR if rng.random() < 0.25 else str(rng.choice(names))
            kind = FaultKind.KILL if rng.random() < 0.5 else FaultKind.PARTITION
            at_s = max(0.0, round(halt.at_s - float(rng.uniform(0.1, 1.5)), 1))
            yield FaultSpec(
                robot=target, kind=kind, at_s=at_s, until_s=round(halt.at_s + float(rng.uniform(0.2, 3.0)), 1)
            )


def _kill(rng: np.random.Generator, target: str, at_s: float) -> FaultSpec:
    on = None
    if rng.random() < 0.4:
        moments = (FaultMoment.TASK_ASSIGNED, FaultMoment.TASK_DONE, FaultMoment.TASK_ACCEPTED)
        on, at_s = (
            FaultMoment(str(rng.choice(moments))),
            round(float(rng.uniform(0.0, 60.0 if rng.random() < 0.7 else 0.3)), 1),
        )
    until_s = at_s + float(rng.choice([0.1, 1.0, 3.0, 10.0]))
    return FaultSpec(robot=target, kind=FaultKind.KILL, at_s=at_s, until_s=round(until_s, 1), on=on)


def _disk(rng: np.random.Generator, target: str, at_s: float) -> FaultSpec:
    return FaultSpec(robot=COORDINATOR, kind=FaultKind.DISK_FULL, at_s=at_s, until_s=_until(rng, at_s, 15.0))


def _drain(rng: np.random.Generator, target: str, at_s: float) -> FaultSpec:
    robot = "r1" if target == COORDINATOR else target
    return FaultSpec(robot=robot, kind=FaultKind.DRAIN, at_s=at_s, soc=round(float(rng.uniform(0.12, 0.3)), 2))


def _lasting(kind: FaultKind, most_s: float, **options: Callable[[np.random.Generator], object]) -> Draw:
    """Draws of a fault that ends after at most this time; its options are drawn first."""

    def draw(rng: np.random.Generator, target: str, at_s: float) -> FaultSpec:
        drawn: dict[str, Any] = {name: option(rng) for name, option in options.items()}
        return FaultSpec(robot=target, kind=kind, at_s=at_s, until_s=_until(rng, at_s, most_s), **drawn)

    return draw


def _late(rng: np.random.Generator, least_s: float) -> tuple[float, float]:
    return 0.0, round(float(rng.uniform(least_s, 0.8)), 1)


_KINDS: dict[str, Draw] = {
    "kill": _kill,
    "hang": _lasting(FaultKind.HANG, 12.0),
    "slow": _lasting(FaultKind.SLOW, 20.0, period_s=lambda rng: round(float(rng.uniform(0.2, 0.9)), 1)),
    "skew": _lasting(
        FaultKind.CLOCK_SKEW,
        20.0,
        skew_s=lambda rng: round(float(rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 20.0)), 1),
    ),
    "disk": _disk,
    "drain": _drain,
    "lose": _lasting(FaultKind.LOSE, 20.0, share=lambda rng: round(float(rng.uniform(0.05, 0.7)), 2)),
    "delay": _lasting(FaultKind.DELAY, 20.0, late_s=lambda rng: _late(rng, 0.1)),
    "reorder": _lasting(FaultKind.REORDER, 20.0, late_s=lambda rng: _late(rng, 0.2)),
    "partition": _lasting(FaultKind.PARTITION, 15.0),
}


def _place(rng: np.random.Generator) -> Point2D:
    x_m, y_m = rng.uniform(0.0, SIDE_M, 2).tolist()
    return Point2D(round(x_m, 1), round(y_m, 1))


def _time(rng: np.random.Generator, least_s: float, most_s: float) -> float:
    return round(float(rng.uniform(least_s, most_s)), 1)


def _until(rng: np.random.Generator, at_s: float, most_s: float) -> float:
    return round(at_s + float(rng.uniform(0.3, most_s)), 1)
