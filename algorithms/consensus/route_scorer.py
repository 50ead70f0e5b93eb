"""Values tasks for a robot that drives to them: their prize less the additional energy of its route.

A route ends at a charger. A task that would be late, or make another late, or leave too little energy for the path to
the charger, cannot be inserted.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from robrain.algorithms.consensus.bidder import Insertion
from robrain.algorithms.consensus.chance import chance
from robrain.protocol.model.energy_model import EnergyModel, Work, estimate
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task

SLACK_J = 1e-6
"""Tolerance for sums of joules, against rounding that depends on the order of summation."""
TWO_OPT_PASSES = 8
"""Passes over a route at most; almost all routes are settled after three."""

NOISE = 0.3
"""Width of the noise of scores, unless another is given (chosen)."""
FREE_START_SHARE = 0.25
"""Share of the variants in which a robot without tasks does not count the path from its place to a charger. Otherwise
it never begins if this path costs more than any single task is worth, though several tasks would be worth the drive."""
LEAST_COST_J = 1e-3
"""Costs below this count as this, for the prize per joule."""

Costs = Sequence[Sequence[float]]
"""From a row's place to a column's; infinite where there is no path."""


class RouteStop(NamedTuple):
    """A task as a route sees it."""

    place: int
    """Index into the costs."""
    prize_j: float
    """Value of the task, in joules."""
    service_s: float = 0.0
    service_j: float = 0.0
    latest_s: float = math.inf
    """Latest end."""


class DriveCost(NamedTuple):
    """Costs of a robot's driving, and its start."""

    energy_j: Costs
    time_s: Costs
    start: int
    ends: tuple[int, ...]
    """Chargers at which a route may end; it takes the one that is cheapest in energy."""
    usable_j: float
    """Energy that it may spend until it is at the charger."""
    counts_end: bool = True
    """Whether the path to the charger is part of a route's cost. The energy for it is kept in any case."""


class RouteScorer:
    """Scores of tasks on the route of one robot.

    Args:
        drive: costs of the robot's driving.
        stops: the tasks that it is able to do, by id.
        noise: width of the noise of scores, relative to them.

    """

    def __init__(self, drive: DriveCost, stops: Mapping[str, RouteStop], noise: float = NOISE) -> None:
        self._drive, self._noise = drive, noise
        self._stops = stops
        places = range(len(drive.energy_j))
        end_of = [min(drive.ends, key=lambda end, place=place: (drive.energy_j[place][end], end)) for place in places]  # type: ignore[misc]
        self._home_j = [drive.energy_j[place][end] for place, end in zip(places, end_of, strict=True)]
        self._end_j = self._home_j if drive.counts_end else [0.0] * len(self._home_j)
        """Of the path to the charger, as far as it counts."""
        self._legs_j = [[*row, end_j] for row, end_j in zip(drive.energy_j, self._end_j, strict=True)]
        """Energy between places; the last column is for the path to the charger."""
        self._is_timed = any(stop.latest_s < math.inf for stop in stops.values())
        is_even = all(drive.energy_j[a][b] == drive.energy_j[b][a] for a in places for b in places[:a])
        self._is_plain = is_even and not self._is_timed
        """Whether a route's cost is the sum of its legs, in either direction."""
        self._variant = 0
        self._kept = 0
        """First tasks of every path that stay where they are."""
        self._spent: tuple[tuple[str, ...], float, list[int]] = ((), 0.0, [drive.start])
        """A path, its energy, and the places from the start on."""
        self._insertions: dict[tuple[str, ...], dict[str, Insertion | None]] = {}
        """Those found by this variant: bundles are rebuilt again and again, mostly alike."""
        self._not_counted_j = 0.0
        """Energy of a route with one task that this variant does not count."""

    def cost_j(self, path: Sequence[str]) -> float:
        """Energy of a route, that to the charger included if it counts; infinite if it cannot be kept, or 0."""
        drive = self._drive
        if not path:
            return 0.0
        now_s, place, spent_j = 0.0, drive.start, 0.0
        for task in path:
            stop = self._stops[task]
            spent_j += drive.energy_j[place][stop.place] + stop.service_j
            now_s = now_s + drive.time_s[place][stop.place] + stop.service_s
            if now_s > stop.latest_s:
                return math.inf
            place = stop.place
        return spent_j + self._end_j[place] if spent_j + self._home_j[place] <= drive.usable_j + SLACK_J else math.inf

    def value(self, path: Sequence[str]) -> float:
        """Prizes less energy of a route."""
        return math.fsum(self._stops[task].prize_j for task in path) - self.cost_j(path)

    def begin(self, variant: int) -> None:
        """See Scorer: variants other than 0 score by prize and energy by three formulas, with noise."""
        self._variant = variant
        start = self._drive.start
        is_free = chance(variant, "start", start) < FREE_START_SHARE
        self._not_counted_j = self._end_j[start] if is_free and self._end_j[start] < math.inf else 0.0
        self._insertions.clear()

    def keep_first(self, count: int) -> None:
        """See Scorer."""
        self._kept = count
        self._insertions.clear()

    def insertion(self, path: Sequence[str], task: str) -> Insertion | None:
        """See Scorer.

        A task that would cost more than its prize is never inserted.
        """
        known = self._insertions.setdefault(tuple(path), {})
        if task not in known:
            known[task] = self._insertion(path, task)
        return known[task]

    def _insertion(self, path: Sequence[str], task: str) -> Insertion | None:
        stop = self._stops.get(task)
        if stop is None:
            return None
        key = tuple(path)
        if self._spent[0] != key:
            self._spent = key, self.cost_j(path), self._places(path)
        base_j = self._spent[1]
        best: Insertion | None = None
        for position, more_j in self._by_energy(self._spent[2], stop):
            if position < self._kept:
                continue
            gain = stop.prize_j - more_j
            if best is not None and not gain > best.gain:
                continue
            if self._is_timed:
                longer_j = self.cost_j([*path[:position], task, *path[position:]])
                gain = stop.prize_j - (longer_j - base_j)
                if longer_j == math.inf or (best is not None and not gain > best.gain):
                    continue
            elif base_j + more_j + self._reserve_j(position, stop) > self._drive.usable_j + SLACK_J:
                continue
            best = Insertion(gain, position)
        if best is None or not self._variant:
            return best
        return best._replace(gain=self._varied(task, stop.prize_j, best.gain + (0.0 if path else self._not_counted_j)))

    def _reserve_j(self, position: int, stop: RouteStop) -> float:
        """Energy to keep for the path to the charger, beside the counted part, with a stop at a position."""
        if self._drive.counts_end:
            return 0.0
        places = self._spent[2]
        return self._home_j[stop.place if position == len(places) - 1 else places[-1]]

    def _varied(self, task: str, prize_j: float, gain_j: float) -> float:
        """The score of this variant: by turns the prize per joule, its square per joule, and the least energy."""
        if not gain_j > 0:
            return 0.0
        cost_j = max(prize_j - gain_j, LEAST_COST_J)
        by = (1.0, prize_j, prize_j * prize_j)[self._variant % 3]
        return by / cost_j * (1 + self._noise * (chance(self._variant, self._drive.start, task) - 0.5))

    def _places(self, path: Sequence[str]) -> list[int]:
        return [self._drive.start, *(self._stops[task].place for task in path)]

    def _by_energy(self, places: list[int], stop: RouteStop) -> list[tuple[int, float]]:
        """Each position with the energy that an insertion there takes more."""
        legs_j, there_j, service_j = self._legs_j, self._legs_j[stop.place], stop.service_j
        found = []
        place = places[0]
        for position, then in enumerate(places[1:]):
            more_j = legs_j[place][stop.place] + there_j[then] - legs_j[place][then] + service_j
            if more_j < math.inf:
                found.append((position, more_j))
            place = then
        back_j = self._end_j[place] if len(places) > 1 else 0.0
        more_j = legs_j[place][stop.place] + there_j[-1] - back_j + service_j
        if more_j < math.inf:
            found.append((len(places) - 1, more_j))
        return found

    def ordered(self, path: Sequence[str]) -> list[str]:
        """The path after moves of one task and reversals of stretches (2-opt), repeated while one saves energy."""
        best = list(path)
        if self._is_plain:
            shorter = self._ordered_by_legs(list(best))
            return best if not self._drive.counts_end and self.cost_j(shorter) == math.inf else shorter
        best_j = self.cost_j(best)
        for _ in range(TWO_OPT_PASSES):
            found = self._better(best, best_j)
            if found is None:
                break
            best, best_j = found
        return best

    def _ordered_by_legs(self, path: list[str]) -> list[str]:
        """As `ordered`, of moves that change few legs."""
        legs_j = self._legs_j
        places = [*self._places(path), len(legs_j)]
        for _ in range(TWO_OPT_PASSES):
            is_better = False
            for first in range(1 + self._kept, len(places) - 1):
                for last in range(1 + self._kept, len(places) - 1):
                    if first < last and _reversal_j(legs_j, places, first, last) < -SLACK_J:
                        places[first : last + 1] = places[first : last + 1][::-1]
                        path[first - 1 : last] = path[first - 1 : last][::-1]
                        is_better = True
                    if first != last and _move_j(legs_j, places, first, last) < -SLACK_J:
                        places.insert(last, places.pop(first))
                        path.insert(last - 1, path.pop(first - 1))
                        is_better = True
            if not is_better:
                break
        return path

    def _better(self, path: list[str], cost_j: float) -> tuple[list[str], float] | None:
        """The route after one pass of moves; None if none saves energy."""
        is_better = False
        for first in range(self._kept, len(path)):
            for last in range(self._kept, len(path)):
                if first < last:
                    changed = path[:first] + path[first : last + 1][::-1] + path[last + 1 :]
                    found_j = self.cost_j(changed)
                    if found_j < cost_j - SLACK_J:
                        path, cost_j, is_better = changed, found_j, True
                if first != last:
                    rest = path[:first] + path[first + 1 :]
                    changed = [*rest[:last], path[first], *rest[last:]]
                    found_j = self.cost_j(changed)
                    if found_j < cost_j - SLACK_J:
                        path, cost_j, is_better = changed, found_j, True
        return (path, cost_j) if is_better else None


def _reversal_j(legs_j: Costs, places: Sequence[int], first: int, last: int) -> float:
    """How much more energy a route takes if it drives the stretch from one index to another in reverse."""
    before, one, other, after = places[first - 1], places[first], places[last], places[last + 1]
    return (legs_j[before][other] - legs_j[before][one]) + (legs_j[one][after] - legs_j[other][after])


def _move_j(legs_j: Costs, places: Sequence[int], first: int, last: int) -> float:
    """How much more energy a route takes if the place at one index moves to another."""
    before, moved, after = places[first - 1], places[first], places[first + 1]
    left, right = (places[last], places[last + 1]) if last > first else (places[last - 1], places[last])
    saved_j = legs_j[before][moved] + legs_j[moved][after] - legs_j[before][after]
    return legs_j[left][moved] + legs_j[moved][right] - legs_j[left][right] - saved_j


DETOUR = 1.5
"""Assumed ratio of a path's length to the straight line (chosen, as in `plugins/behavior/budget.py`)."""
CONFIDENCE = 0.95
PRIZE_SHARE = 10.0
"""Prize of a task of priority 1, as a multiple of the longest path of the problem (chosen: every task is worth its
path)."""
NOISE = 1.0
"""Width of the noise of scores in rounds of improvement. There are few rounds, so they should differ much. Measured for
5 robots with 15 tasks: 20 rounds save 12 % of the path length, and 5 % with a width of 0.3."""
WorkOf = Callable[[Task], Work]


def task_scorer(
    tasks: Sequence[Task], at: Point2D, ends: Sequence[Point2D], model: EnergyModel | None, now_ns: int, work_of: WorkOf
) -> RouteScorer:
    """Scores of tasks for a robot.

    Args:
        tasks: those that the robot is able to do.
        at: where it is.
        ends: chargers; without any, the place where it has to be in the end.
        model: costs of its work; None counts metres and assumes enough energy.
        now_ns: the time.
        work_of: work of a task at its place.

    """
    places = [*(task.place for task in tasks), at, *ends]
    lengths_m = [[DETOUR * math.hypot(a.x_m - b.x_m, a.y_m - b.y_m) for b in places] for a in places]
    metre = Work(path_m=1.0)
    per_m_j = 1.0 if model is None else estimate(model, Work(path_m=100.0)).high_j(CONFIDENCE) / 100.0
    per_m_s = 1.0 if model is None else estimate(model, metre).duration_s
    worth_j = PRIZE_SHARE * per_m_j * (1.0 + max(max(row) for row in lengths_m))
    stops = {}
    for index, task in enumerate(tasks):
        work = work_of(task)
        service = None if model is None else estimate(model, work)
        stops[task.id] = RouteStop(
            index,
            worth_j * task.priority + (0.0 if service is None else service.high_j(CONFIDENCE)),
            service_s=work.wait_s if service is None else service.duration_s,
            service_j=0.0 if service is None else service.high_j(CONFIDENCE),
            latest_s=math.inf if task.deadline_ns is None else (task.deadline_ns - now_ns) / 1e9,
        )
    drive = DriveCost(
        energy_j=[[length_m * per_m_j for length_m in row] for row in lengths_m],
        time_s=[[length_m * per_m_s for length_m in row] for row in lengths_m],
        start=len(tasks),
        ends=tuple(range(len(tasks) + 1, len(places))),
        usable_j=math.inf if model is None else model.usable_j,
        counts_end=False,
    )
    return RouteScorer(drive, stops, NOISE)
