"""Dense traffic: robots that go back and forth through narrow places, without a coordinator's help."""

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from robrain.agent.host.robot_file import RobotFile
from robrain.agent.plugin import Behavior, external
from robrain.algorithms.exploration.strategies import NO_EXPLORATION
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.deploy.command_line.terminal import print_line
from robrain.lab.bench.figure import Figure, at_most, deterministic
from robrain.lab.bench.mapping_plan import BenchPlan, check_limits, names_of, numbers_of, run_all
from robrain.plugins.behavior.travel import Travel, TravelParameters, TravelState
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Metres
from robrain.recording.invariants.judging import Judging
from robrain.recording.invariants.robot_invariants import MutualWait
from robrain.sim.faults.fault_spec import COORDINATOR, FaultKind, FaultSpec
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.robot.robot_hardware import ArenaRobot
from robrain.sim.scenarios.scenario_file import MAX_SEED
from robrain.sim.world.robot_specs import RobotSpec
from robrain.sim.world.world import Fidelity, World, build_world

CELL_M = 0.1
RADIUS_M = 0.2
MOVED_M = 0.1
"""Less than this is no motion."""
WAIT_S = 60.0
"""Longest wait allowed."""
STOP_S, STOPS_EVERY_S = 10.0, 60.0
"""With faults: each robot stops for the first time, once in the second on average."""
LOST = 0.1
"""With faults: share of messages that are lost."""
COURIER = Path(__file__).parent / "courier"
"""Folder of the manifest of `Courier`."""
WITHOUT = ("camera", "mote_base", "sensor_board", "explore", "recharge")
Place = tuple[float, float]


class TrafficFloor(NamedTuple):
    """A floor, and the places between which each robot goes; it starts at the last of them."""

    plan: FloorPlan
    rounds: list[list[Place]]


UNFINISHED = (TravelState.MOVING, TravelState.WAITING)


class Courier(Behavior):
    """Goes to its places in turn, or to a place that a caller gives; yields while it has no goal."""

    class Parameters(TravelParameters, frozen=True, forbid_unknown_fields=True):
        """Where to go."""

        places: Annotated[tuple[tuple[Metres, Metres], ...], Meta(max_length=1000)] = ()
        """x and y, arena frame; the robot begins with the first again after the last."""

    period_s = 0.2
    parameters: Parameters

    def init(self) -> None:
        self.travel = Travel(self.env, self.parameters)
        self.state = TravelState.ARRIVED
        self.trips = 0
        """Number of places reached."""

    def activate(self) -> None:
        self.travel.connect()

    def emergency_halt(self) -> None:
        self.travel.forget()

    @external
    def go(self, x_m: Metres, y_m: Metres, priority: float = 0.0) -> bool:
        """Set out; false if there is no path."""
        sets_out = self.travel.set_out(Point2D(x_m, y_m), priority=priority)
        self.state = TravelState.MOVING if sets_out else TravelState.NO_PATH
        return sets_out

    def step(self) -> None:
        if self.state in UNFINISHED:
            self.state = self.travel.step()
            if self.state in UNFINISHED:
                return
            self.trips += self.state is TravelState.ARRIVED
            self.travel.stop()
        places = self.parameters.places
        if not places or not self.go(*places[self.trips % len(places)]):
            self.travel.make_room()


@dataclass(frozen=True, kw_only=True)
class CourierWorld(World):
    """A world whose robots are couriers."""

    rounds: list[list[Place]]

    def robot_file(
        self, robot: ArenaRobot, *, team: str = DEFAULT_TEAM, connect: tuple[str, ...] = (), is_restart: bool = False
    ) -> RobotFile:
        """Configuration of a robot's agent."""
        file = super().robot_file(robot, team=team, connect=connect, is_restart=is_restart)
        table, places = file.robot, self.rounds[self.robots.index(robot)]
        table = msgspec.structs.replace(
            table, load=[*(table.load or ()), "courier"], places=[*table.places, str(COURIER)]
        )
        return msgspec.structs.replace(
            file, robot=table, parameters=file.parameters | {"courier": {"places": [list(place) for place in places]}}
        )


def floor_of(width_m: float, height_m: float, *boxes: tuple[float, float, float, float]) -> FloorPlan:
    """Solid but for these boxes (x0, y0, x1, y1), metres."""
    occupied = np.ones((round(height_m / CELL_M), round(width_m / CELL_M)), np.bool_)
    for box in boxes:
        x0, y0, x1, y1 = (round(edge_m / CELL_M) for edge_m in box)
        occupied[y0:y1, x0:x1] = False
    return FloorPlan(occupied, CELL_M, 0.0, 0.0, "traffic")


def _swap(_seed: int) -> TrafficFloor:
    plan = floor_of(12.0, 4.0, (0.3, 0.5, 2.1, 3.5), (9.9, 0.5, 11.7, 3.5), (2.1, 1.7, 9.9, 2.5), (5.5, 2.5, 6.5, 3.3))
    left, right = (1.2, 2.0), (10.8, 2.0)
    return TrafficFloor(plan, [[right, left], [left, right]])


def _lane(_seed: int) -> TrafficFloor:
    """20 robots in two rooms, joined by a lane of 15 m for one robot with three passing places."""
    bays = [(x_m, 3.4, x_m + 1.6, 4.4) for x_m in (8.0, 11.7, 15.4)]
    plan = floor_of(25.0, 6.0, (0.3, 0.3, 5.0, 5.7), (20.0, 0.3, 24.7, 5.7), (5.0, 2.5, 20.0, 3.4), *bays)
    places = [(x_m, y_m) for y_m in (0.9, 1.8, 3.0, 4.2, 5.1) for x_m in (1.0, 2.2)]
    other = [(25.0 - x_m, y_m) for x_m, y_m in places]
    rounds = [[there, here] for here, there in zip(places, other, strict=True)]
    return TrafficFloor(plan, rounds + [[here, there] for here, there in zip(places, other, strict=True)])


def _crossing(_seed: int) -> TrafficFloor:
    """16 robots in four corridors of 1.6 m that meet: each goes to the opposite end and back."""
    plan = floor_of(16.0, 16.0, (0.3, 7.2, 15.7, 8.8), (7.2, 0.3, 8.8, 15.7))
    rounds = []
    for quarter in range(4):
        for along_m, aside_m in ((7.2, -0.4), (7.2, 0.4), (6.2, -0.4), (6.2, 0.4)):
            angle_rad = quarter * math.pi / 2
            cos, sin = round(math.cos(angle_rad)), round(math.sin(angle_rad))
            start = 8.0 + along_m * cos - aside_m * sin, 8.0 + along_m * sin + aside_m * cos
            end = 8.0 - along_m * cos - aside_m * sin, 8.0 - along_m * sin + aside_m * cos
            rounds.append([end, start])
    return TrafficFloor(plan, rounds)


def _dead_end(_seed: int) -> TrafficFloor:
    """6 robots that go round six places, three of them one behind the other in a dead end for one robot."""
    plan = floor_of(12.0, 5.0, (0.3, 0.3, 5.0, 4.7), (5.0, 2.0, 11.7, 3.0))
    places = [(11.0, 2.5), (1.2, 1.0), (9.0, 2.5), (1.2, 2.5), (7.0, 2.5), (1.2, 4.0)]
    return TrafficFloor(plan, [[*places[number + 1 :], *places[: number + 1]] for number in range(len(places))])


def _random(seed: int) -> TrafficFloor:
    """12 robots on twelve rooms whose doors are drawn from the seed; each goes round three places."""
    rng = np.random.default_rng([seed, 12])
    columns, rows, side_m, wall_m = 4, 3, 4.0, 0.2
    boxes = [
        (column * side_m + wall_m, row * side_m + wall_m, (column + 1) * side_m, (row + 1) * side_m)
        for row in range(rows)
        for column in range(columns)
    ]
    walls = [(room, room + 1) for room in range(columns * rows) if room % columns < columns - 1]
    walls += [(room, room + columns) for room in range(columns * (rows - 1))]
    group = list(range(columns * rows))
    for index in rng.permutation(len(walls)).tolist():
        one, other = walls[index]
        if group[one] == group[other] and rng.random() > DOORS:
            continue
        group = [group[one] if each == group[other] else each for each in group]
        width_m, share = float(rng.uniform(*DOOR_M)), float(rng.uniform(0.1, 0.9))
        x0, y0, x1, y1 = boxes[other]
        if other == one + 1:
            at_m = y0 + share * (y1 - y0 - width_m)
            boxes.append((x0 - wall_m, at_m, x0, at_m + width_m))
        else:
            at_m = x0 + share * (x1 - x0 - width_m)
            boxes.append((at_m, y0 - wall_m, at_m + width_m, y0))
    plan = floor_of(columns * side_m + wall_m, rows * side_m + wall_m, *boxes)
    corners = [(x0 + dx, y0 + dy) for x0, y0, _, _ in boxes[: columns * rows] for dx in (0.7, 3.1) for dy in (0.7, 3.1)]
    drawn = [corners[index] for index in rng.permutation(len(corners))[:36].tolist()]
    return TrafficFloor(plan, [drawn[3 * number : 3 * number + 3] for number in range(12)])


DOORS = 0.3
"""Share of further doors, beyond those that join all rooms."""
DOOR_M = (0.9, 1.4)
"""Widths of doors."""
FLOORS: dict[str, Callable[[int], TrafficFloor]] = {
    "swap": _swap,
    "lane": _lane,
    "crossing": _crossing,
    "dead_end": _dead_end,
    "random": _random,
}
DURATION_S = {"swap": 600.0, "lane": 3600.0, "crossing": 600.0, "dead_end": 600.0, "random": 300.0}


class TrafficCase(msgspec.Struct, frozen=True, kw_only=True):
    """One run."""

    floor: str
    seed: int
    with_faults: bool
    """A tenth of the messages is lost, robots stop for a while, and the coordinator is dead."""
    duration_s: float


class TrafficRun(msgspec.Struct, frozen=True, kw_only=True):
    """Result of a run."""

    case: TrafficCase
    trips: int
    """Places reached by all robots."""
    contacts: int
    """Pairs of robots that touched each other."""
    longest_wait_s: float
    """Longest time without motion of a robot, except during its own fault."""
    blocked: int
    """Number of robots that had not moved for `WAIT_S` at the end."""
    mutual_waits: int
    """Pairs of robots that waited for each other for longer than `robrain check` allows."""


def run_case(case: TrafficCase) -> TrafficRun:
    """Make one run."""
    floor = FLOORS[case.floor](case.seed)
    faults = tuple(_faults(len(floor.rounds), case)) if case.with_faults else ()
    world = _world(floor, case.seed, faults)
    run = LockstepRun(world, planning=PlanningPolicy(exploration=NO_EXPLORATION), processes=case.with_faults)
    judging = Judging(judges=(MutualWait,))
    try:
        run.follow(judging.receive)
        observer = _Observer(run, faults)
        while run.sim_time_s < case.duration_s:
            run.tick()
            observer.step()
        return observer.result(case, judging)
    finally:
        run.close()


def _world(floor: TrafficFloor, seed: int, faults: tuple[FaultSpec, ...]) -> CourierWorld:
    specs = [
        RobotSpec(place_m=places[-1], without=WITHOUT, plugins={"mapper": {"known": True}}) for places in floor.rounds
    ]
    world = build_world(floor.plan, len(specs), 0, None, seed, specs=specs)
    fields = {field.name: getattr(world, field.name) for field in dataclasses.fields(world)}
    fields |= {"faults": faults, "idle": True, "fidelity": Fidelity.POINTS}
    return CourierWorld(**fields, rounds=floor.rounds)


def _faults(robots: int, case: TrafficCase) -> Iterator[FaultSpec]:
    rng = np.random.default_rng([case.seed, robots])
    yield FaultSpec(robot=COORDINATOR, kind=FaultKind.KILL, at_s=1.0)
    for number in range(1, robots + 1):
        yield FaultSpec(robot=f"r{number}", kind=FaultKind.LOSE, at_s=0.0, share=LOST)
        at_s = float(rng.exponential(STOPS_EVERY_S))
        while at_s < case.duration_s:
            yield FaultSpec(robot=f"r{number}", kind=FaultKind.HANG, at_s=at_s, until_s=at_s + STOP_S)
            at_s += STOP_S + float(rng.exponential(STOPS_EVERY_S))


class _Observer:
    """Observes the robots of a run."""

    def __init__(self, run: LockstepRun, faults: tuple[FaultSpec, ...]) -> None:
        self._run = run
        self._stops = [
            [
                (fault.at_s, fault.until_s or 0.0)
                for fault in faults
                if fault.kind is FaultKind.HANG and fault.robot == robot.name
            ]
            for robot in run.world.robots
        ]
        self._touching: set[tuple[int, int]] = set()
        self.contacts = 0
        self._places = self._now_m()
        self._moved_s = np.zeros(len(self._places))
        self._longest_s = 0.0

    def _now_m(self) -> Floats:
        return np.array([(robot.x_m, robot.y_m) for robot in self._run.arena.bodies])

    def step(self) -> None:
        """Look at the robots, once each tick."""
        now_s, places = self._run.sim_time_s, self._now_m()
        moved = np.hypot(*(places - self._places).T) > MOVED_M
        for index, stops in enumerate(self._stops):
            moved[index] |= any(begin_s <= now_s <= end_s for begin_s, end_s in stops)
        self._places[moved], self._moved_s[moved] = places[moved], now_s
        self._longest_s = max(self._longest_s, now_s - float(self._moved_s.min()))
        apart_m = np.hypot(*(places[:, np.newaxis] - places).transpose(2, 0, 1))
        touching = {(one, other) for one, other in np.argwhere(apart_m < 2 * RADIUS_M - 0.01).tolist() if one < other}
        self.contacts += len(touching - self._touching)
        self._touching = touching

    def result(self, case: TrafficCase, judging: Judging) -> TrafficRun:
        """The result of the run so far."""
        now_s = self._run.sim_time_s
        couriers = [host.manager.get("courier").plugin for host in self._run.hosts]
        return TrafficRun(
            case=case,
            trips=sum(courier.trips for courier in couriers if isinstance(courier, Courier)),
            contacts=self.contacts,
            longest_wait_s=self._longest_s,
            blocked=int((now_s - self._moved_s > WAIT_S).sum()),
            mutual_waits=sum(ruling.broken for ruling in judging.finish()),
        )


def choose(floors: str, seeds: str, jobs: int, time_limit_s: float) -> BenchPlan[TrafficCase]:
    """Make the runs from the options, each floor without and with faults (UsageError if one is wrong).

    The seeds draw the random floors and the faults.
    """
    check_limits(jobs, time_limit_s)
    cases = [
        TrafficCase(floor=name, seed=seed, with_faults=with_faults, duration_s=min(time_limit_s, DURATION_S[name]))
        for name in names_of("--floors", floors, FLOORS)
        for seed in numbers_of("--seeds", seeds, 0, MAX_SEED)
        for with_faults in (False, True)
    ]
    return BenchPlan(cases=cases, jobs=jobs)


def run_bench(plan: BenchPlan[TrafficCase], json_file: Path | None = None) -> None:
    """Execute all runs; print a line for each, and the figures at the end."""

    def report(runs: list[TrafficRun]) -> None:
        run = runs[-1]
        print_line(
            f"{_text_of(run.case)}, seed {run.case.seed}: {run.trips} places reached, longest wait "
            f"{run.longest_wait_s:.0f} s, {run.contacts} contacts"
        )

    run_all("traffic", plan, run_case, report, figures, json_file)


def figures(runs: Sequence[TrafficRun]) -> Iterator[Figure]:
    """Waits, contacts and throughput of each floor, over the seeds."""
    for name in dict.fromkeys(_text_of(run.case) for run in runs):
        alike = [run for run in runs if _text_of(run.case) == name]
        minutes = sum(run.case.duration_s for run in alike) / 60.0
        yield deterministic(f"{name}: longest wait", max(run.longest_wait_s for run in alike), "s", at_most(WAIT_S))
        yield deterministic(f"{name}: blocked robots at the end", sum(run.blocked for run in alike), "", at_most(0))
        yield deterministic(f"{name}: mutual waits", sum(run.mutual_waits for run in alike), "", at_most(0))
        yield deterministic(f"{name}: contacts", sum(run.contacts for run in alike), "", at_most(0))
        yield deterministic(f"{name}: places reached in a minute", sum(run.trips for run in alike) / minutes)


def _text_of(case: TrafficCase) -> str:
    return f"{case.floor}{', with faults' if case.with_faults else ''}"
