"""Random zones that change while a team explores and does tasks: entries, speeds, robots in new zones, refusals.

`python -m tests.bench.zones 200` prints the figures of that many sets.
"""

import math
import sys
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from robrain import CallError, Scenario, Team
from robrain.algorithms.warm_up import warm_up
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.lab.bench.figure import Figure, at_least, at_most, deterministic
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.zone import Zone, ZoneKind
from robrain.recording.invariants.judging import Judging
from robrain.recording.invariants.zone_invariants import ZonesObeyed
from robrain.sim.lockstep.lockstep import LockstepRun, LockstepTransport
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.world.world import Fidelity, World

FLOORS = ("arena_small", "cave", "depot", "hospital", "office", "warehouse")
SETS = 24
ROBOTS_MAX = 8
BEGIN_S, CHANGE_S, END_S = 2.0, 15.0, 40.0
"""First zones, others, and the end of a run."""
SIZE_M = (0.6, 2.5)
LIMITS_M_S = (0.15, 0.3)
TASKS = 3
"""Beside one in each keep-out zone."""


def _zone(rng: np.random.Generator, name: str, centre: Point2D, kind: ZoneKind) -> Zone:
    corners, radius_m, turn_rad = int(rng.integers(3, 8)), float(rng.uniform(*SIZE_M)), float(rng.uniform(0.0, 6.28))
    angles_rad = [turn_rad + 2.0 * math.pi * number / corners for number in range(corners)]
    return Zone(
        name=name,
        kind=kind,
        corners_m=tuple(
            (centre.x_m + radius_m * math.cos(angle), centre.y_m + radius_m * math.sin(angle)) for angle in angles_rad
        ),
        speed_m_s=float(rng.choice(LIMITS_M_S)) if kind is ZoneKind.SPEED_LIMIT else None,
        cost_m=5.0 if kind is ZoneKind.PENALTY else None,
        direction_rad=turn_rad if kind is ZoneKind.DIRECTED else None,
    )


def _place(rng: np.random.Generator, plan: FloorPlan) -> Point2D:
    cells = np.argwhere(plan.clearance_m > 0.4)
    row, column = cells[int(rng.integers(len(cells)))].tolist()
    return plan.geometry.center_of(row, column)


KINDS = (ZoneKind.KEEP_OUT, ZoneKind.SPEED_LIMIT, ZoneKind.PENALTY, ZoneKind.PLACE, ZoneKind.KEEP_OUT)
LATER_KINDS = (ZoneKind.DIRECTED, ZoneKind.NO_STOPPING, ZoneKind.RESERVED)
"""From random numbers of their own, so that the other zones are those of earlier versions."""
POLL_S, AGAINST_M, STANDS_M, STAYS_S = 0.5, 0.1, 0.01, 10.0


def _zones(rng: np.random.Generator, world: World, prefix: str, kinds: Sequence[ZoneKind] = KINDS) -> list[Zone]:
    return [_zone(rng, f"{prefix}{kind}{number}", _place(rng, world.plan), kind) for number, kind in enumerate(kinds)]


def run_set(number: int) -> Counter[str]:
    """Make one run; counts breaches by their codes, robots in new zones, and refusals."""
    rng = np.random.default_rng([number, 42])
    robots = 1 + int(rng.integers(ROBOTS_MAX))
    scenario = Scenario.builtin(FLOORS[number % len(FLOORS)]).replace(
        robots=robots, seed=number, fidelity=Fidelity.POINTS
    )
    world = scenario.world()
    run = LockstepRun(world, planning=PlanningPolicy())
    judging = Judging(judges=(ZonesObeyed,))
    run.follow(judging.receive)
    found = Counter[str]()
    try:
        team = Team(LockstepTransport(run), by="bench")
        team.run_for(BEGIN_S)
        zones = _zones(rng, world, "a-")
        team.change_zones(*zones)
        team.run_for(CHANGE_S - BEGIN_S)
        body = run.arena.bodies[int(rng.integers(robots))]
        others = [*_zones(rng, world, "b-"), _zone(rng, "here", Point2D(body.x_m, body.y_m), ZoneKind.KEEP_OUT)]
        later = _zones(np.random.default_rng([number, 43]), world, "c-", LATER_KINDS)
        zones = team.change_zones(*others, *later, remove=[zone.name for zone in zones[:2]])
        shut = [zone for zone in zones if zone.kind is ZoneKind.KEEP_OUT]
        inside = {
            index
            for index, each in enumerate(run.arena.bodies)
            if any(zone.holds(Point2D(each.x_m, each.y_m)) for zone in shut)
        }
        found["inside"] += len(inside)
        for place in [*(zone.centre for zone in shut), *(_place(rng, world.plan) for _ in range(TASKS))]:
            names = [zone.name for zone in shut if zone.holds(place)]
            try:
                team.submit("visit", place=place)
                found["accepted in a zone"] += bool(names)
            except CallError as error:
                found["refused"] += any(zone.name in str(error) for zone in shut)
        stood_s = _follow(run, team, *later[:2], shut, found)
        found["stays"] += sum(each_s >= STAYS_S for each_s in stood_s)
        for index in inside:
            place = Point2D(run.arena.bodies[index].x_m, run.arena.bodies[index].y_m)
            found["left"] += not any(zone.holds(place) for zone in shut)
        [ruling] = judging.finish()
        found.update(breach.finding["code"] for breach in ruling.breaches)
        found["collisions"] += run.arena.collisions
    finally:
        run.close()
    return found


def _follow(
    run: LockstepRun, team: Team, one_way: Zone, no_stopping: Zone, shut: list[Zone], found: Counter[str]
) -> list[float]:
    """Run to the end; counts motion against the one-way zone, and returns how long each robot stands in the other.

    A robot that leaves a keep-out zone may drive against the direction.
    """
    direction_rad = one_way.direction_rad or 0.0
    along = math.cos(direction_rad), math.sin(direction_rad)
    last = [Point2D(each.x_m, each.y_m) for each in run.arena.bodies]
    stood_s = [0.0 for _ in last]
    for _ in range(round((END_S - CHANGE_S) / POLL_S)):
        team.run_for(POLL_S)
        now = [Point2D(each.x_m, each.y_m) for each in run.arena.bodies]
        for index, (place, before) in enumerate(zip(now, last, strict=True)):
            moved_m = (place.x_m - before.x_m) * along[0] + (place.y_m - before.y_m) * along[1]
            is_leaving = any(zone.holds(before) for zone in shut)
            is_inside = one_way.holds(place) and one_way.holds(before) and not is_leaving
            found["against"] += is_inside and moved_m < -AGAINST_M
            stands = no_stopping.holds(place) and place.distance_m(before) < STANDS_M
            stood_s[index] = stood_s[index] + POLL_S if stands else 0.0
        last = now
    return stood_s


def figures(sets: int) -> Iterator[Figure]:
    """Figures of this many random sets of zones."""
    warm_up()
    found = sum((run_set(number) for number in range(sets)), Counter[str]())
    yield deterministic(f"{sets} sets: entries into keep-out zones", found["entered"], "", at_most(0))
    yield deterministic(f"{sets} sets: speeds above a limit by more than 5 %", found["too_fast"], "", at_most(0))
    yield deterministic(f"{sets} sets: entries into occupied reserved zones", found["not_alone"], "", at_most(0))
    share = 100.0 * found["left"] / max(1, found["inside"])
    beside = f"{found['inside']} robots"
    yield deterministic(f"{sets} sets: robots in new zones that left within 25 s", share, "%", at_least(100), beside)
    yield deterministic(f"{sets} sets: moves of 0.5 s against a one-way zone", found["against"], "", at_most(0))
    yield deterministic(f"{sets} sets: robots that stand in a no-stopping zone", found["stays"], "", at_most(0))
    yield deterministic(f"{sets} sets: tasks accepted in keep-out zones", found["accepted in a zone"], "", at_most(0))
    yield deterministic(f"{sets} sets: tasks refused with the zone's name", found["refused"])
    yield deterministic(f"{sets} sets: collisions", found["collisions"], "", at_most(0))


def measure() -> Iterator[Figure]:
    """Figures of the section."""
    return figures(SETS)


if __name__ == "__main__":
    for figure in figures(int(sys.argv[1])):
        sys.stdout.write(f"{figure.name}: {figure.value:g} {figure.unit} {figure.beside}\n")
