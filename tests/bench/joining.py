"""Robots that do not know where they are: how soon they join the team's map, and whether they ever join it wrongly.

Two kinds of runs, in lockstep. *Unknown starts*: robots are scattered over a floor, and only the first is told where.
The time counts from when both maps show 15 m of the same walls and 20 m² of the same floor, by the truth, to when the
robot maps in the team's frame. *Carried off*: when a team has explored for a while, a robot is put down elsewhere on
known floor. The time counts from then until it knows its place again.
"""

import math
from collections.abc import Iterable, Iterator

import msgspec
import numpy as np

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.slam.map_overlap import MapMatcher
from robrain.deploy.errors import UsageError
from robrain.lab.bench.figure import Figure, at_least, at_most, deterministic
from robrain.lab.bench.mapping_plan import Case, errors_alone
from robrain.protocol.errors import RobrainError
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.map_frame import ARENA
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.maps.placement import Starts
from robrain.sim.world.world import World

KINDS = ("unknown", "carried")
JOINED_WITHIN_S = 20.0
JOINED_BOUND_PERCENT = 95.0
RIGHT_M = 1.0
"""A robot that is farther off has joined in a wrong place; errors of the team's own map are smaller than that."""
OVERLAP_CELLS = 150
"""Common wall cells of 0.1 m above which two maps count as overlapping, if both also share floor:"""
OVERLAP_FLOOR_CELLS = 2000
"""Common floor cells needed for that."""
LOOK_S = 0.5
SETTLED_S = 30.0
"""So long after the last robot has joined the run goes on: a false join may show only then."""
CARRIED_AT_S = 45.0
CARRIED_M = 4.0
"""At least so far from where it was."""


class JoiningRun(msgspec.Struct, frozen=True, kw_only=True):
    """What became of one robot that did not know its place."""

    case: Case
    kind: str
    robot: str = ""
    overlap_s: float | None = None
    """When its map began to overlap with that of the team, or when it was carried off; None if it never did."""
    joined_s: float | None = None
    error_m: float = 0.0
    """The largest error of its position afterwards."""
    refusal: str = ""

    @property
    def took_s(self) -> float | None:
        """From the overlap to the join; 0 if it joined before. None if one of them did not happen."""
        if self.overlap_s is None or self.joined_s is None:
            return None
        return max(self.joined_s - self.overlap_s, 0.0)

    @property
    def is_false(self) -> bool:
        """Whether it joined in a wrong place."""
        return self.joined_s is not None and self.error_m > RIGHT_M

    @property
    def is_in_time(self) -> bool:
        """Whether it joined in time, and rightly."""
        return self.took_s is not None and self.took_s <= JOINED_WITHIN_S and not self.is_false


def figures(runs: Iterable[JoiningRun]) -> Iterator[Figure]:
    """Shares and times of each kind, beside their bounds."""
    made = [each for each in runs if not each.refusal]
    for kind in KINDS:
        own = [each for each in made if each.kind == kind and each.overlap_s is not None]
        if not own:
            continue
        what = "unknown starts" if kind == "unknown" else "carried off"
        in_time = 100.0 * sum(each.is_in_time for each in own) / len(own)
        found = 100.0 * sum(each.joined_s is not None and not each.is_false for each in own) / len(own)
        beside, bound = f"{len(own)} robots", at_least(JOINED_BOUND_PERCENT)
        # A robot that has been carried off has to find out first, and to look around: it may take its time.
        is_timed = kind == "unknown"
        name = f"{what}: joined rightly within {JOINED_WITHIN_S:g} s"
        yield deterministic(name, in_time, "%", bound if is_timed else None, beside)
        yield deterministic(f"{what}: joined rightly in the end", found, "%", None if is_timed else bound, beside)
        times_s = sorted(each.took_s if each.took_s is not None else math.inf for each in own)
        yield deterministic(f"{what}: time to join, median", times_s[len(times_s) // 2], "s", None, beside)
        false = float(sum(each.is_false for each in made if each.kind == kind))
        yield deterministic(f"{what}: false joins", false, "", at_most(0.0), beside)


def run_case(asked: tuple[Case, str]) -> list[JoiningRun]:
    """Make one run; `refusal` gives the reason if it cannot be made."""
    case, kind = asked
    try:
        with errors_alone():
            return list(_unknown_starts(case) if kind == "unknown" else _carried_off(case))
    except RobrainError as error:
        return [JoiningRun(case=case, kind=kind, refusal=str(error))]


def _unknown_starts(case: Case) -> Iterator[JoiningRun]:
    scenario = case.scenario().replace(near=None, starts=Starts.SCATTERED, starts_known=False)
    run = LockstepRun(scenario.world())
    watch = _Watch(run, [host.name for host in run.hosts[1:]])
    try:
        until_s = case.time_limit_s
        while run.sim_time_s < until_s:
            watch.go_on()
            for name in watch.names:
                watch.record_overlap(name)
            if all(name in watch.joined_s for name in watch.names):
                until_s = min(until_s, max(watch.joined_s.values()) + SETTLED_S)
    finally:
        run.close()
    for name in watch.names:
        yield watch.joining(case, "unknown", name)


def _carried_off(case: Case) -> Iterator[JoiningRun]:
    world = case.scenario().world()
    run = LockstepRun(world)
    name = run.hosts[-1].name
    watch = _Watch(run, [name])
    try:
        while run.sim_time_s < CARRIED_AT_S:
            watch.go_on()
        run.arena.robot(name).body.carry_to(_place(world, run, name))
        watch.begin_at(name)
        while run.sim_time_s < CARRIED_AT_S + case.time_limit_s and run.sim_time_s < watch.until_s(name):
            watch.go_on()
    finally:
        run.close()
    yield watch.joining(case, "carried", name)


class _Watch:
    """Follows robots that do not know their place, beside the truth."""

    def __init__(self, run: LockstepRun, names: list[str]) -> None:
        self.run = run
        self.names = names
        self.overlap_s: dict[str, float] = {}
        self.joined_s: dict[str, float] = {}
        self.error_m: dict[str, float] = dict.fromkeys(names, 0.0)
        self._was_lost: set[str] = set()

    def begin_at(self, name: str) -> None:
        """The robot has just been carried off."""
        self.overlap_s[name] = self.run.sim_time_s
        self.joined_s.clear()
        self.error_m[name] = 0.0

    def until_s(self, name: str) -> float:
        """When all is seen of a robot."""
        return self.joined_s.get(name, math.inf) + SETTLED_S

    def go_on(self) -> None:
        """Run for `LOOK_S`, and look."""
        run = self.run
        until_s = run.sim_time_s + LOOK_S
        while run.sim_time_s < until_s - 1e-9:
            run.tick()
        true = {robot.robot: robot.pose for robot in run.truth.robots}
        for host in run.hosts:
            board, name = host.board, host.name
            if name not in self.names or board.pose is None:
                continue
            if board.lost or board.frame != ARENA:
                self._was_lost.add(name)
                self.joined_s.pop(name, None)
            elif name in self._was_lost:
                self.joined_s.setdefault(name, run.sim_time_s)
                self.error_m[name] = max(self.error_m[name], board.pose.distance_m(true[name]))

    def record_overlap(self, name: str) -> None:
        """Note when the maps of a robot and of the team begin to overlap."""
        if name in self.overlap_s:
            return
        hosts = {host.name: host for host in self.run.hosts}
        own, team = hosts[name].board.map, hosts[self.run.hosts[0].name].board.map
        pose = hosts[name].board.pose
        if own is None or team is None or pose is None or name in self.joined_s:
            return
        true = next(robot.pose for robot in self.run.truth.robots if robot.robot == name)
        overlap = MapMatcher(own, team).overlap(true.compose(pose.inverse()))
        if overlap.agreeing >= OVERLAP_CELLS and overlap.floor >= OVERLAP_FLOOR_CELLS:
            self.overlap_s[name] = self.run.sim_time_s

    def joining(self, case: Case, kind: str, name: str) -> JoiningRun:
        """What became of a robot."""
        joined_s = self.joined_s.get(name)
        overlap_s = self.overlap_s.get(name, joined_s)
        if joined_s is None and overlap_s is not None and self.run.sim_time_s - overlap_s < JOINED_WITHIN_S:
            overlap_s = None  # the run ended before there was time enough
        error_m = self.error_m[name] if joined_s is not None else 0.0
        return JoiningRun(
            case=case, kind=kind, robot=name, overlap_s=overlap_s, joined_s=joined_s, error_m=round(error_m, 3)
        )


def _place(world: World, run: LockstepRun, name: str) -> Pose2D:
    """Somewhere on floor that the team knows, away from where the robot is and from the others."""
    rng = np.random.default_rng([world.seed, 77])
    bodies = {robot.robot: robot.pose for robot in run.truth.robots}
    grid: OccupancyGrid = run.arena.referee.grid
    plan = world.plan
    cells = np.argwhere(grid.log_odds < 0)
    rng.shuffle(cells)
    for row, column in cells.tolist():
        place = grid.geometry.center_of(row, column)
        at = plan.geometry.cell_of(place.x_m, place.y_m)
        is_free = plan.geometry.contains(*at) and plan.clearance_m[at] > 2.0 * world.robots[0].radius_m
        is_clear = all(pose.distance_m(place) > 1.0 for pose in bodies.values())
        if is_free and is_clear and bodies[name].distance_m(place) > CARRIED_M:
            return Pose2D(place.x_m, place.y_m, float(rng.uniform(-math.pi, math.pi)))
    raise UsageError(f"{plan.name}: no known floor {CARRIED_M:g} m from {name}")
