"""Dense traffic: places reached by right of way alone, beside a centralised plan by LaCAM* on the same floors.

The plan's robots occupy the places of a square grid, move from one to the next in the time that a robot of the team
needs at full speed, all at once, and have neither delay nor margins. The plan is made anew when one of them has reached
a place.
"""

import itertools
from collections.abc import Iterator

import numpy as np

from robrain.algorithms.warm_up import warm_up
from robrain.lab.bench.figure import Figure, at_least, at_most, deterministic
from robrain.lab.bench.traffic import FLOORS, RADIUS_M, WAIT_S, Place, TrafficCase, TrafficFloor, run_case
from robrain.plugins.behavior.travel import TravelParameters
from robrain.sim.maps.floor_plan import FloorPlan
from tests.bench.team_paths import Joint, TeamPaths

DURATION_S = {"swap": 300.0, "lane": 600.0, "crossing": 600.0, "dead_end": 600.0, "random": 200.0}
PITCH_M = 0.57
"""Robots that follow each other round a corner come as near as 0.71 of it, and must not touch."""
STEPS = 500
"""Joint steps that a plan tries."""
ATTEMPTS = 100
SHARE = 0.85
"""Bound on the throughput over that of the plan."""
SEED = 1


class PlannedTeam:
    """Robots that follow centralised plans.

    Args:
        floor: the floor and the places between which they go.

    """

    def __init__(self, floor: TrafficFloor) -> None:
        cells = _cells(floor.plan)
        index = {cell: number for number, cell in enumerate(cells)}
        near = [[(row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)] for row, column in cells]
        self._paths = TeamPaths([[index[cell] for cell in four if cell in index] for four in near])
        self._places_m = PITCH_M * np.array(cells)[:, ::-1]
        self._rounds = [[self._nearest(place, set()) for place in places] for places in floor.rounds]
        self._now: Joint = tuple(places[-1] for places in self._rounds)
        self._trips = [0] * len(self._rounds)
        self._plans = 0

    def reached(self, duration_s: float) -> int:
        """Number of places that the robots reach in that time."""
        step_s, now_s = PITCH_M / TravelParameters().speed_m_s, 0.0
        while now_s < duration_s:
            goals = [places[trips % len(places)] for places, trips in zip(self._rounds, self._trips, strict=True)]
            for joint in self._plan(goals)[1:]:
                now_s += step_s
                self._now = joint
                arrived = [robot for robot, place in enumerate(joint) if place == goals[robot]]
                for robot in arrived:
                    self._trips[robot] += 1
                if arrived or now_s >= duration_s:
                    break
        return sum(self._trips)

    def _plan(self, goals: list[int]) -> list[Joint]:
        """A plan to the goals; if the search finds none, half of the robots, drawn, first go somewhere else."""
        ends = self._apart(goals)
        for _ in range(ATTEMPTS):
            self._plans += 1
            path = self._paths.plan(self._now, tuple(ends), self._plans, STEPS)
            if path is not None and len(path) > 1:
                return path
            rng = np.random.default_rng(self._plans)
            ends = [
                goal if rng.random() < 0.5 else int(rng.integers(len(self._places_m))) for goal in self._apart(goals)
            ]
            ends = self._apart(ends)
        raise RuntimeError(f"no plan found in {ATTEMPTS} attempts")

    def _apart(self, goals: list[int]) -> list[int]:
        """Where two robots have one goal, the one that is farther away goes beside it."""
        found, used = list(goals), set[int]()
        for robot in sorted(range(len(goals)), key=lambda each: self._paths.distances(goals[each])[self._now[each]]):
            x_m, y_m = self._places_m[goals[robot]]
            found[robot] = self._nearest((float(x_m), float(y_m)), used)
            used.add(found[robot])
        return found

    def _nearest(self, place: Place, without: set[int]) -> int:
        apart_m = np.hypot(*(self._places_m - place).T)
        return next(each for each in np.argsort(apart_m, kind="stable").tolist() if each not in without)


def _cells(plan: FloorPlan) -> list[tuple[int, int]]:
    """Rows and columns of the places, `PITCH_M` apart, where a robot has room."""
    rows, columns = (range(1 + int(cells * plan.resolution_m / PITCH_M)) for cells in plan.clearance_m.shape)
    all_cells = itertools.product(rows, columns)
    return [cell for cell in all_cells if plan.clearance_at(PITCH_M * cell[1], PITCH_M * cell[0]) >= RADIUS_M]


def measure() -> Iterator[Figure]:
    """Throughput of each floor over that of the plan, longest wait, contacts."""
    warm_up()
    for floor, duration_s in DURATION_S.items():
        run = run_case(TrafficCase(floor=floor, seed=SEED, with_faults=False, duration_s=duration_s))
        planned = PlannedTeam(FLOORS[floor](SEED)).reached(duration_s)
        beside = f"{run.trips} places reached, {planned} by the plan"
        yield deterministic(f"{floor}: throughput over LaCAM*", run.trips / planned, "", at_least(SHARE), beside)
        yield deterministic(f"{floor}: longest wait", run.longest_wait_s, "s", at_most(WAIT_S))
        yield deterministic(f"{floor}: contacts", run.contacts, "", at_most(0))
