"""Decides how far a robot may drive where its path meets those of others.

Each robot publishes its path and its claim (`claim.py`). A robot that stands or drives where another has yet to pass is
ahead of it and goes first (`orders`). Otherwise claims decide. Both are compared alike on both sides, so two robots
that receive each other agree on which one yields, without an arbiter. This is prioritised planning, one pair at a time
(Erdmann and Lozano-Pérez, *On Multiple Moving Objects*, Algorithmica 2, 1987; Silver, *Cooperative Pathfinding*, AIIDE
2005). The robot that goes first drives as if alone. The robot that yields keeps out of the other's whole remaining
path, unless it passes in time. A robot that stands there moves aside.

Positions are (N, 2) in metres, arena frame, `STEP_M` apart along the path. A robot is at position k of its path at k ·
STEP_M / speed.
"""

import heapq
import itertools
import math
from collections.abc import Sequence
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple

import msgspec
import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.numeric.kernel_array import FLOAT64, Floats, kernel_array
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import GridGeometry

STEP_M = 0.1
"""From one position of a path to the next; half of a small robot's width would be enough."""
LOOK_AHEAD_M = 10.0
"""Length of the own path that is checked, chosen: some 15 s, more than two robots need to agree on priority."""
TEAMMATE_AHEAD_M = 25.0
"""Length of a teammate's path that is checked, chosen: the longest corridor that two robots should not both enter."""
LONGEST_M = 1000.0
"""The longest path that is followed."""
BEHIND_M, SHARED_M = 5.0, 1.5
"""Of robots that drive one behind the other (chosen)."""
SEARCH = 30
"""Largest number of positions by which a robot advances between two checks: 3 m."""


class Track(msgspec.Struct, frozen=True, eq=False):
    """A teammate's remaining path for the right of way."""

    positions: Floats
    """(M, 2), its remaining path from its present place; that place alone if it stands."""
    speed_m_s: float
    held_at: int
    """The position at which it waits for others; the last one if it does not."""
    keep_m: float
    """Both radii: centres as near as this touch."""
    goes_first: bool


class Release(NamedTuple):
    """The released part of a robot's path."""

    positions: int
    """Number of released positions, counted from the first; with 1 the robot stands still."""
    is_whole: bool
    """All checked positions are released."""
    must_leave: bool
    """The robot stands where a robot with priority has yet to pass."""
    by: int
    """Index of the teammate that limits the released part; −1 if there is none."""


class Margins(msgspec.Struct, frozen=True, kw_only=True):
    """Distances and times kept from teammates."""

    contest_m: float = 0.12
    """Between two hulls, for a place to be off the other's path."""
    guard_m: float = 0.08
    """Least distance between two hulls, regardless of priority: no robot drives on into less."""
    slack_s: float = 1.0
    """A robot that crosses before or behind one that goes first is earlier or later by this."""
    guard_s: float = 2.5
    """Time that the guard looks ahead; beyond it, the prediction of a teammate is unreliable."""


def sample_path(points: Floats, limit_m: float) -> Floats:
    """Positions `STEP_M` apart along a polyline (N, 2), for `limit_m` or to its end; both its ends are among them."""
    return _sample(kernel_array(points, FLOAT64), STEP_M, float(limit_m))


def pass_on(routes: Sequence[Floats], passed: Sequence[int], places: Floats) -> list[int]:
    """The position on its path (M, 2) that each robot at `places` (N, 2) has passed.

    A passed position stays passed. So a path that returns to an earlier place is not cut short.

    Args:
        routes: positions of each path.
        passed: the position of each that it had passed before.
        places: where the robots are now.

    """
    begins = np.array([0, *itertools.accumulate([len(route) for route in routes])])
    now = np.array(passed, np.int64)
    _pass_on(np.concatenate(routes), begins, now, kernel_array(places, FLOAT64))
    found: list[int] = now.tolist()
    return found


def release(
    own: Floats, speed_m_s: float, tracks: Sequence[Track], margins: Margins, *, yields: bool = True
) -> Release:
    """How far a robot may go along its own positions (N, 2), the first of which is where it is.

    Towards a teammate that goes first, an own position is *contested* while the teammate has still to pass within reach
    of it. A contested stretch is entered only if at every position of it the two are apart by `slack_s` in time. A
    robot that is already in one continues if it gets out of it ahead of the teammate, and must leave it otherwise.
    Towards all teammates, the path ends where in the next `guard_s` the hulls would come nearer than `guard_m`. Without
    `yields`, that alone counts.
    """
    if not tracks:
        return Release(own.shape[0], is_whole=True, must_leave=False, by=-1)
    positions = [track.positions for track in tracks]
    begins = np.array([0, *itertools.accumulate([len(track) for track in positions])])
    count, must_leave, by = _release(
        own,
        STEP_M / speed_m_s,
        np.concatenate(positions),
        begins,
        np.array([STEP_M / max(track.speed_m_s, 1e-3) for track in tracks]),
        np.array([track.held_at for track in tracks], np.int64),
        np.array([track.keep_m for track in tracks], np.float64),
        np.array([yields and track.goes_first for track in tracks], np.bool_),
        margins.contest_m,
        margins.guard_m,
        margins.slack_s,
        margins.guard_s,
    )
    return Release(count, is_whole=count == own.shape[0], must_leave=must_leave, by=by)


def meet(own: Floats, track: Track, margin_m: float, within: int | None = None) -> bool:
    """Whether a teammate's remaining path, or its positions `within`, come within reach of own ones (N, 2)."""
    return _meet(own, track.positions[:within], float(track.keep_m + margin_m))


def any_within(tracks: Sequence[Track], place: Point2D, within_m: float) -> list[bool]:
    """For each track, whether any of its positions is within a distance of a place."""
    if not tracks:
        return []
    positions = [track.positions for track in tracks]
    counts = np.array([len(each) for each in positions])
    found: list[bool] = _any_within(
        np.concatenate(positions), counts, float(place.x_m), float(place.y_m), float(within_m)
    ).tolist()
    return found


class PathOrder(IntEnum):
    """Which of two robots is on the remaining path of the other, and so ahead of it."""

    NEITHER = 0  # or both: they meet head-on
    OWN = 1
    OTHER = 2
    LEADS = 3
    """The other is ahead, by at most `BEHIND_M`, and its path is that of this robot for `SHARED_M`."""


def orders(own: Floats, tracks: Sequence[Track], margin_m: float) -> list[int]:
    """The `PathOrder` of this robot and each other; within `keep_m` and `margin_m` of a path (N, 2) one is on it."""
    routes, counts, reaches_m = [], [], []
    for track in tracks:
        routes.append(track.positions)
        counts.append(len(track.positions))
        reaches_m.append(track.keep_m + margin_m)
    found: list[int] = _orders(own, np.concatenate(routes), np.array(counts), np.array(reaches_m)).tolist()
    return found


class DrivenPath:
    """A path that is being driven along.

    Args:
        points: (N, 2), metres, arena frame; N at least 1.

    """

    def __init__(self, points: Floats) -> None:
        self._points = points
        self._positions = sample_path(points, LONGEST_M)
        self._passed = 0
        self._ahead: tuple[float, float, float, Floats] | None = None

    @cached_property
    def _at_m(self) -> Floats:
        """Distance along the path of each of its points."""
        legs_m = np.hypot(*np.diff(self._points, axis=0).T)
        return np.concatenate(([0.0], np.cumsum(legs_m)))

    @property
    def passed_m(self) -> float:
        """Length of the path behind the robot."""
        return self._passed * STEP_M

    @property
    def length_m(self) -> float:
        """The whole of it."""
        return float(self._at_m[-1])

    @property
    def end(self) -> Point2D:
        """End of the path."""
        return Point2D(float(self._points[-1, 0]), float(self._points[-1, 1]))

    @property
    def left_m(self) -> float:
        """Length of the path ahead of the robot."""
        return max(0.0, self.length_m - self.passed_m)

    def ahead(self, x_m: float, y_m: float, limit_m: float) -> Floats:
        """Positions from a place on, for `limit_m`: the place itself, then those that lie ahead of it.

        A passed position stays passed. So a path that returns to an earlier place is not cut short.
        """
        known = self._ahead
        if known is not None and known[:3] == (x_m, y_m, limit_m):
            return known[3]
        self._passed = int(_passed_at(self._positions, self._passed, float(x_m), float(y_m)))
        rest = self._positions[self._passed + 1 : self._passed + 1 + round(limit_m / STEP_M)]
        ahead = np.empty((len(rest) + 1, 2))
        ahead[0] = x_m, y_m
        ahead[1:] = rest
        self._ahead = x_m, y_m, limit_m, ahead
        return ahead

    def points_until(self, at_m: float) -> Floats:
        """Its points from here to a place on it, `at_m` along it; the last lies there."""
        if at_m >= self.length_m:
            return self._points[min(np.searchsorted(self._at_m, self.passed_m, "right"), len(self._points) - 1) :]
        between = (self._at_m > self.passed_m) & (self._at_m < at_m)
        end = self._positions[min(round(at_m / STEP_M), self._positions.shape[0] - 1)]
        return np.concatenate((self._points[between], end[None]))


@njit(cache=True, nogil=True)
def _passed_at(positions: Floats, passed: int, x_m: float, y_m: float) -> int:
    """The position nearest to a place among the next `SEARCH` ones; of equally near ones the first."""
    nearest, nearest_2 = passed, np.inf
    for k in range(passed, min(passed + SEARCH, positions.shape[0])):
        dx, dy = positions[k, 0] - x_m, positions[k, 1] - y_m
        if dx * dx + dy * dy < nearest_2:
            nearest, nearest_2 = k, dx * dx + dy * dy
    return nearest


@njit(cache=True, nogil=True)
def _pass_on(positions: Floats, begins: NDArray[np.int64], passed: NDArray[np.int64], places: Floats) -> None:
    """Set the passed positions of several paths, which lie one behind the other, from `begins[n]` on."""
    for n in range(passed.shape[0]):
        route = positions[begins[n] : begins[n + 1]]
        passed[n] = _passed_at(route, passed[n], places[n, 0], places[n, 1])


@njit(cache=True, nogil=True)
def _any_within(
    positions: Floats, counts: NDArray[np.int64], x_m: float, y_m: float, within_m: float
) -> NDArray[np.bool_]:
    """As `any_within`, of tracks that lie one behind the other in `positions` (N, 2); `counts` (T,) their lengths."""
    found = np.zeros(counts.shape[0], np.bool_)
    begin = 0
    for track in range(counts.shape[0]):
        for k in range(begin, begin + counts[track]):
            dx, dy = positions[k, 0] - x_m, positions[k, 1] - y_m
            if dx * dx + dy * dy <= within_m * within_m:
                found[track] = True
                break
        begin += counts[track]
    return found


@njit(cache=True, nogil=True)
def _orders(own: Floats, routes: Floats, counts: NDArray[np.int64], reaches_m: Floats) -> NDArray[np.int64]:
    """As `orders`, of routes that lie one behind the other; `counts` (T,) are their lengths."""
    found = np.zeros(counts.shape[0], np.int64)
    behind, shared = round(BEHIND_M / STEP_M), round(SHARED_M / STEP_M)
    begin = 0
    for other in range(counts.shape[0]):
        end, reach_m = begin + counts[other], reaches_m[other]
        is_ahead = _meet(own[:1], routes[begin:end], reach_m)
        if is_ahead != _meet(own, routes[begin : begin + 1], reach_m):
            found[other] = 1 if is_ahead else 2
            at = _nearest(own[: behind + 1], routes[begin], reach_m)
            is_behind = not is_ahead and at > 0 and end - begin > shared
            if is_behind and _nearest(own[at:], routes[begin + shared], reach_m) >= shared // 2:
                found[other] = 3
        begin = end
    return found


@njit(cache=True, nogil=True)
def _nearest(path: Floats, place: Floats, within_m: float) -> int:
    """The position of a path (N, 2) that is nearest to a place (2,); −1 if none is within that distance."""
    nearest, nearest_2 = -1, within_m * within_m
    for k in range(path.shape[0]):
        dx, dy = path[k, 0] - place[0], path[k, 1] - place[1]
        if dx * dx + dy * dy < nearest_2:
            nearest, nearest_2 = k, dx * dx + dy * dy
    return nearest


@njit(cache=True, nogil=True)
def _stride_m(positions: Floats, first: int, last: int) -> float:
    """The greatest distance from one position of a track to the next, and a little more."""
    stride_2 = 0.0
    for k in range(first, last):
        dx, dy = positions[k + 1, 0] - positions[k, 0], positions[k + 1, 1] - positions[k, 1]
        stride_2 = max(stride_2, dx * dx + dy * dy)
    return math.sqrt(stride_2) + 1e-6


@njit(cache=True, nogil=True)
def _sample(points: Floats, step_m: float, limit_m: float) -> Floats:
    samples = np.empty((_samples_max(points, step_m, limit_m), 2))
    return samples[: _fill(samples, points, step_m, limit_m)].copy()


@njit(cache=True, nogil=True)
def _samples_max(points: Floats, step_m: float, limit_m: float) -> int:
    length_m = 0.0
    for k in range(1, points.shape[0]):
        length_m += math.hypot(points[k, 0] - points[k - 1, 0], points[k, 1] - points[k - 1, 1])
    return math.floor(min(length_m, limit_m) / step_m + 1e-9) + 2


@njit(cache=True, nogil=True)
def _fill(samples: Floats, points: Floats, step_m: float, limit_m: float) -> int:
    """Write the samples of a polyline; returns how many there are."""
    most = _samples_max(points, step_m, limit_m) - 1
    samples[0] = points[0]
    count = 1
    passed_m = 0.0
    for k in range(1, points.shape[0]):
        dx, dy = points[k, 0] - points[k - 1, 0], points[k, 1] - points[k - 1, 1]
        leg_m = math.hypot(dx, dy)
        while count < most and count * step_m <= passed_m + leg_m:
            share = (count * step_m - passed_m) / leg_m
            samples[count, 0] = points[k - 1, 0] + share * dx
            samples[count, 1] = points[k - 1, 1] + share * dy
            count += 1
        passed_m += leg_m
    if passed_m <= limit_m and passed_m > (count - 1) * step_m + 0.01:
        samples[count] = points[points.shape[0] - 1]
        count += 1
    return count


@njit(cache=True, nogil=True)
def _meet(own: Floats, other: Floats, reach_m: float) -> bool:
    for k in range(own.shape[0]):
        for j in range(other.shape[0]):
            dx, dy = other[j, 0] - own[k, 0], other[j, 1] - own[k, 1]
            if dx * dx + dy * dy < reach_m * reach_m:
                return True
    return False


@njit(cache=True, nogil=True)
def _release(
    own: Floats,
    own_step_s: float,
    tracks: Floats,
    begins: NDArray[np.int64],
    steps_s: Floats,
    held_at: NDArray[np.int64],
    keep_m: Floats,
    goes_first: NDArray[np.bool_],
    contest_m: float,
    guard_m: float,
    slack_s: float,
    guard_s: float,
) -> tuple[int, bool, int]:
    """Released positions, whether the first must be left, and the teammate that ends the path (−1: none)."""
    count = own.shape[0]
    contested_by = np.full(count, -1, np.int64)
    """The first teammate that contests each own position."""
    late = np.zeros(count, np.bool_)
    """Teammate and robot would meet there, at nearly the same time."""
    meets = np.zeros(count, np.bool_)
    """They would meet there if both kept exactly to their times."""
    for teammate in range(begins.shape[0] - 1):
        if not goes_first[teammate]:
            continue
        first, last = begins[teammate], begins[teammate + 1] - 1
        held = held_at[teammate] < last - first
        reach_2 = (keep_m[teammate] + contest_m) ** 2
        stride_m = _stride_m(tracks, first, last)
        for k in range(count):
            own_s = k * own_step_s
            j = first - 1
            while j < last:
                j += 1
                dx, dy = tracks[j, 0] - own[k, 0], tracks[j, 1] - own[k, 1]
                if dx * dx + dy * dy >= reach_2:
                    # The track needs at least this number of positions to come within reach.
                    j += max(0, int((math.sqrt(dx * dx + dy * dy) - keep_m[teammate] - contest_m) / stride_m) - 1)
                    continue
                if contested_by[k] < 0:
                    contested_by[k] = teammate
                teammate_s = (j - first) * steps_s[teammate]
                # A held teammate comes later than foreseen, at an unknown time; one that has arrived stays there.
                stays = held or j == last
                if own_s + slack_s >= teammate_s and (stays or own_s - slack_s <= teammate_s):
                    late[k] = True
                if own_s + 0.5 * own_step_s >= teammate_s and (stays or own_s - 0.5 * own_step_s <= teammate_s):
                    meets[k] = True
                if k == count - 1 and teammate_s >= own_s:  # the robot stays at the end of its path
                    late[k] = True
                    meets[k] = True
    end, by, must_leave = count, -1, False
    k = 0
    while k < count:
        if contested_by[k] < 0:
            k += 1
            continue
        begin, is_free = k, True
        while k < count and contested_by[k] >= 0:
            if late[k] if begin > 0 else meets[k]:
                is_free = False
            k += 1
        if not is_free:
            end, by, must_leave = max(begin, 1), contested_by[begin], begin == 0
            break

    guarded = min(count - 1, int(guard_s / own_step_s) + 1)
    guarded_m = guarded * _stride_m(own, 0, guarded)
    """Distance that the robot can drive within the guard's time."""
    for teammate in range(begins.shape[0] - 1):
        first, last = begins[teammate], begins[teammate + 1] - 1
        last = min(last, first + held_at[teammate])
        reach_m = keep_m[teammate] + guard_m
        now_m = math.hypot(tracks[first, 0] - own[0, 0], tracks[first, 1] - own[0, 1])
        soon = min(last, first + int((guard_s + 0.5) / steps_s[teammate]) + 1)
        if now_m - guarded_m - (soon - first) * _stride_m(tracks, first, soon) > reach_m:
            continue
        for k in range(1, end):
            own_s = k * own_step_s
            if own_s > guard_s:
                break
            # Where the teammate may be by then: on time, or up to half a second late or early.
            low = min(last, first + int(max(0.0, own_s - 0.5) / steps_s[teammate]))
            high = min(last, first + int((own_s + 0.5) / steps_s[teammate]) + 1)
            nearest_m = np.inf
            for j in range(low, high + 1):
                nearest_m = min(nearest_m, math.hypot(tracks[j, 0] - own[k, 0], tracks[j, 1] - own[k, 1]))
            # A robot that is already too near may go where that does not get worse.
            if nearest_m < reach_m and nearest_m < now_m - 0.02:
                end, by = max(1, k - 1), teammate
                break
    return end, must_leave, by


WINDOW_M = 12.0
"""Refuges are searched for within this distance, chosen: farther away another path is worth more than waiting."""
HEAD_START_S = 0.5
"""A teammate comes later than foreseen by at least this: it starts first, and brakes before robots on its path."""
LATE_S = 1e6
NEVER_S = 1e9
"""When cells close that are no refuge for another reason."""
START_CELLS = 3.0
"""Within this distance of its start a robot may be nearer to a teammate than it should be, if it moves away."""
_ROW_STEPS = (-1, 0, 0, 1, -1, -1, 1, 1)
_COLUMN_STEPS = (0, -1, 1, 0, -1, 1, -1, 1)
_DIAGONAL = 2.0**0.5


def escape_cells(
    traversable: NDArray[np.bool_],
    geometry: GridGeometry,
    start: tuple[int, int],
    speed_m_s: float,
    tracks: Sequence[Track],
    apart_m: float,
    no_rest: NDArray[np.bool_] | None = None,
    *,
    is_late: bool = False,
) -> NDArray[np.int32] | None:
    """Path (N, 2), rows and columns, from a cell to the nearest one that no teammate still has to pass; None for none.

    A cell closes when the first teammate with priority comes within its `keep_m + apart_m` of the cell. A refuge is a
    cell that never closes. Each cell of the path is reached before it closes. As cells only ever close, Dijkstra's
    search finds the earliest arrival (Dreyfus, *An Appraisal of Some Shortest-Path Algorithms*, Operations Research 17,
    1969). The path keeps this distance from every teammate, regardless of priority. `traversable` is (H, W).

    With `is_late` no cell closes before this robot has passed it: teammates stay behind it. No refuge lies in the mask
    `no_rest` (H, W).
    """
    row, column = start
    reach = round(WINDOW_M / geometry.resolution_m)
    low_row, low_column = max(0, row - reach), max(0, column - reach)
    around = np.s_[low_row : row + reach + 1, low_column : column + reach + 1]
    window = np.ascontiguousarray(traversable[around])
    closes_s = np.where(window, np.inf, 0.0)
    if no_rest is not None:
        closes_s[window & no_rest[around]] = NEVER_S
    origin = (geometry.origin_x_m, geometry.origin_y_m)
    if tracks:
        positions = [track.positions for track in tracks]
        _close_all(
            closes_s,
            (np.concatenate(positions) - origin) / geometry.resolution_m - (low_column + 0.5, low_row + 0.5),
            np.array([len(each) for each in positions]),
            np.array([STEP_M / track.speed_m_s if track.goes_first else 0.0 for track in tracks]),
            np.array([(track.keep_m + apart_m) / geometry.resolution_m for track in tracks]),
            row - low_row,
            column - low_column,
            LATE_S if is_late else HEAD_START_S,
        )
    found = _escape(window, closes_s, row - low_row, column - low_column, geometry.resolution_m / speed_m_s)
    return found + np.array([low_row, low_column], np.int32) if found.shape[0] else None


@njit(cache=True, nogil=True)
def _close_all(
    closes_s: Floats,
    cells: Floats,
    counts: NDArray[np.int64],
    steps_s: Floats,
    reaches_cells: Floats,
    row: int,
    column: int,
    begin_s: float,
) -> None:
    """Close the cells that each track closes to a robot at (row, column); `steps_s` is 0 without priority."""
    end = 0
    for track in range(counts.shape[0]):
        begin, end = end, end + counts[track]
        if steps_s[track] > 0.0:
            _close(closes_s, cells[begin:end], steps_s[track], begin_s, reaches_cells[track])
        _close_around(closes_s, cells[begin], reaches_cells[track], row, column)


@njit(cache=True, nogil=True)
def _close_around(closes_s: Floats, cell: Floats, reach_cells: float, row: int, column: int) -> None:
    """Close the cells within reach of a teammate's place; a robot at (row, column) that is nearer may move away."""
    height, width = closes_s.shape
    x, y = cell
    away_cells = math.hypot(x - column, y - row)
    for near_row in range(max(0, math.ceil(y - reach_cells)), min(height, math.floor(y + reach_cells) + 1)):
        for near_column in range(max(0, math.ceil(x - reach_cells)), min(width, math.floor(x + reach_cells) + 1)):
            apart_cells = math.hypot(x - near_column, y - near_row)
            is_start = math.hypot(column - near_column, row - near_row) <= START_CELLS
            if apart_cells < (min(reach_cells, away_cells) if is_start else reach_cells):
                closes_s[near_row, near_column] = 0.0


@njit(cache=True, nogil=True)
def _close(closes_s: Floats, cells: Floats, step_s: float, begin_s: float, reach_cells: float) -> None:
    """Cells within reach of positions (N, 2; x, y in cells) close when these are passed, one each `step_s`."""
    height, width = closes_s.shape
    for k in range(cells.shape[0]):
        x, y = cells[k, 0], cells[k, 1]
        at_s = begin_s + k * step_s
        for row in range(max(0, math.ceil(y - reach_cells)), min(height, math.floor(y + reach_cells) + 1)):
            half = math.sqrt(max(0.0, reach_cells**2 - (row - y) ** 2))
            # The rim itself stays open: it is as near as that, and not nearer.
            for column in range(max(0, math.floor(x - half) + 1), min(width, math.ceil(x + half))):
                closes_s[row, column] = min(closes_s[row, column], at_s)


@njit(cache=True, nogil=True)
def _escape(
    traversable: NDArray[np.bool_], closes_s: Floats, row: int, column: int, cell_s: float
) -> NDArray[np.int32]:
    """The cells of the path, start included; none if there is no refuge."""
    height, width = traversable.shape
    arrives_s = np.full(height * width, np.inf)
    parent = np.full(height * width, -1, np.int64)
    start = row * width + column
    arrives_s[start] = 0.0
    heap = [(0.0, start)]
    while len(heap) > 0:
        at_s, cell = heapq.heappop(heap)
        if at_s > arrives_s[cell]:
            continue
        row, column = cell // width, cell % width
        if closes_s[row, column] == np.inf:
            count = 1
            back = cell
            while parent[back] >= 0:
                back = parent[back]
                count += 1
            route = np.empty((count, 2), np.int32)
            for k in range(count - 1, -1, -1):
                route[k, 0], route[k, 1] = cell // width, cell % width
                cell = parent[cell]
            return route
        for k in range(8):
            near_row, near_column = row + _ROW_STEPS[k], column + _COLUMN_STEPS[k]
            if not (0 <= near_row < height and 0 <= near_column < width and traversable[near_row, near_column]):
                continue
            if k >= 4 and not (traversable[row, near_column] and traversable[near_row, column]):
                continue
            near_s = at_s + (_DIAGONAL if k >= 4 else 1.0) * cell_s
            near = near_row * width + near_column
            if near_s < closes_s[near_row, near_column] and near_s < arrives_s[near]:
                arrives_s[near] = near_s
                parent[near] = cell
                heapq.heappush(heap, (near_s, near))
    return np.empty((0, 2), np.int32)
