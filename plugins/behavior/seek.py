"""Seek: finds the source of a plume. Climbs the field of a quantity until it has seen it fall on all sides.

The field consists of measurements of the robot's sensor board on the path, and recent readings of motes around. From
the place of the task on, the robot goes where the fitted field rises most, until a fitted summit is near. It drives
around that summit; if the field still has its summit within the circle, that is the source. If not, it drives around
the new summit. Where the field is flat, it searches for a rise on a spiral. Where walls keep it from climbing on, the
highest place that it has reached is the result, marked as being at a wall.
"""

import math
from collections.abc import Generator

import msgspec

from robrain.agent.event import Event
from robrain.algorithms.navigation.source_seeking import FieldFit, FieldSamples
from robrain.plugins.behavior.errand import Errand, Failed, Script
from robrain.plugins.behavior.travel import TROUBLE, TravelState
from robrain.plugins.device.sensor_board import SensorBoardInterface
from robrain.plugins.skill.energy import Work
from robrain.protocol.border.reading_sieve import measured_at_ns
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.errors import CallError
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.motes.mote_messages import MOTE_READING
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import SEEK, Seek
from robrain.protocol.model.tasks.task import Task

SAMPLE_S = 0.5
PROBE_M = 1.0
"""Distance that the robot first drives to three sides: without readings beside the path there is no slope."""
STEP_M = 1.5
"""It climbs in steps of this length. A fitted summit that is nearer than two of them, and more accurate than one, is
measured from all sides."""
CIRCLE_M = 1.0
"""Radius of the circle on which a summit is measured from all sides."""
CIRCLE_POINTS = 5
CIRCLES_MAX = 4
SIDES_MIN = 3
"""Points of the circle that must be reached: walls may block the others."""
SUMMIT_SD_M = 0.5
"""Largest standard deviation of a source's place."""
MOVED_M = 0.3
"""A step that moves the robot less than this has failed."""
STUCK_MAX = 4
"""Number of consecutive steps without a gain that end the climb."""
GOLDEN_RAD = math.radians(137.5)
SPIRAL_M = 0.8
"""The first turn of the spiral; its radius grows by the square root."""
WIDTH_M = 2.5
NEAR_WIDTH_M = 1.2
"""Distance at which readings count a quarter: during the climb, and on the circle around the summit."""
RECEIVED_S = 60.0
"""Readings of motes that are older do not count."""
PACE_M_S = 0.25
"""Of a climb, stops included, for the estimate of its cost (measured)."""
ANYWHERE_RAD = (0.0, math.radians(50.0), math.radians(-50.0), math.radians(100.0), math.radians(-100.0))
"""If there is no path uphill, the robot tries to go around, in this order."""

Drive = Generator[None, None, bool]
"""A part of a script that returns whether the robot got there."""


class SourceFound(msgspec.Struct, frozen=True, kw_only=True):
    """A source was found."""

    task: str
    quantity: str
    value: float
    """As fitted."""
    place: Point2D
    """Arena frame."""
    sd_m: float
    """Standard deviation of the place along x or y, by the fit alone."""
    at_wall: bool
    """The field rises further behind an obstacle; the place is the highest that the robot has reached."""


class SeekBehavior(Errand[Seek]):
    """Finds the place of a quantity's maximum."""

    kind = SEEK
    found = Event[SourceFound](outside=True)

    def init(self) -> None:
        super().init()
        self._readings = Inbox(capacity=256)
        self._receives_motes = False

    def activate(self) -> None:
        self._board = self.env.use("sensor_board", SensorBoardInterface)
        self._receives_motes = False
        super().activate()

    def work(self, task: Task, seek: Seek) -> Work:
        """All of its allowed time, half of it driving, and the path back to the place."""
        return Work(path_m=PACE_M_S * seek.duration_s + seek.reach_m, wait_s=0.5 * seek.duration_s)

    def do(self, task: Task, seek: Seek) -> Script:
        """Climb. Result: `x_m`, `y_m`, `value`, `quantity`, `sd_m`, `at_wall`, `samples`, `received`."""
        if not self._receives_motes:
            self._receives_motes = True
            self.env.wire.subscribe(self._readings, MOTE_READING)
        self._task, self._seek, self._field = task, seek, FieldSamples()
        self._samples = self._received = self._next_ns = 0
        self._value, self._sd_m, self._is_at_wall = math.nan, math.inf, False  # of the summit that was found
        self._until_ns = self.env.clock.now_ns() + to_ns(seek.duration_s)
        summit = yield from self._climb()
        place = Point2D(round(summit.x_m, 3), round(summit.y_m, 3))
        value, sd_m, at_wall = round(self._value, 3), round(self._sd_m, 3), self._is_at_wall
        self.found.notify(
            SourceFound(task=task.id, quantity=seek.quantity, value=value, place=place, sd_m=sd_m, at_wall=at_wall)
        )
        return {
            "x_m": place.x_m,
            "y_m": place.y_m,
            "value": value,
            "quantity": seek.quantity,
            "sd_m": sd_m,
            "at_wall": at_wall,
            "samples": self._samples,
            "received": self._received,
        }

    def _climb(self) -> Generator[None, None, Point2D]:
        """The place of the source.

        Raises:
            Failed: there is none within reach, or time is up.

        """
        yield from self._probe()
        stuck = turns = 0
        top = -math.inf
        while stuck < STUCK_MAX:
            self._check_time()
            here = self.travel.place()
            fit = self._fit(here)
            summit = fit.summit if fit is not None and fit.summit_sd_m < STEP_M else None
            if summit is not None and summit.distance_m(here) < 2.0 * STEP_M:
                found = yield from self._drive_around_summit(summit)
                if found is not None:
                    return found
                stuck += 1
            elif fit is None or fit.is_flat:
                turns += 1
                yield from self._drive(self._on_spiral(turns))
            else:
                stuck = stuck + 1 if fit.value <= top else 0
                top = max(top, fit.value)
                yield from self._uphill(fit, here)
        highest = self._field.highest()
        if highest is None:
            raise Failed(f"cannot get nearer to the source of {self._seek.quantity}")
        yield from self._drive(highest.place)
        self._is_at_wall, self._value, self._sd_m = True, highest.value, CIRCLE_M
        return highest.place

    def _probe(self) -> Generator[None, None, None]:
        for turn in range(3):
            self._sample(self.travel.place())
            yield from self._drive(_off(self._task.place, PROBE_M, turn * math.tau / 3))
        if not len(self._field):
            raise Failed(f"nothing tells {self._seek.quantity}: neither the robot's own board nor a mote that is heard")

    def _drive_around_summit(self, summit: Point2D) -> Generator[None, None, Point2D | None]:
        """Drive around a summit, and around the one that is fitted then; None if it is found nowhere near."""
        for _ in range(CIRCLES_MAX):
            reached = yield from self._circle(summit)
            fit = self._fit(summit, NEAR_WIDTH_M)
            if fit is None or fit.summit is None or reached < SIDES_MIN:
                return None
            off_m = fit.summit.distance_m(summit)
            if off_m <= CIRCLE_M and fit.summit_sd_m <= SUMMIT_SD_M:
                self._value, self._sd_m = fit.summit_value, fit.summit_sd_m
                return fit.summit
            if off_m > 2.0 * STEP_M:
                return None
            summit = fit.summit
        return None

    def _circle(self, middle: Point2D) -> Generator[None, None, int]:
        """Drive around a place; returns the number of reached points of the circle."""
        reached = 0
        here = self.travel.place()
        begin_rad = math.atan2(here.y_m - middle.y_m, here.x_m - middle.x_m)
        for point in range(CIRCLE_POINTS):
            goal = _off(middle, CIRCLE_M, begin_rad + point * math.tau / CIRCLE_POINTS)
            got_there = yield from self._drive(goal)
            reached += got_there and self.travel.place().distance_m(goal) < CIRCLE_M
        return reached

    def _uphill(self, fit: FieldFit, here: Point2D) -> Generator[None, None, None]:
        """One step up, around obstacles."""
        yaw_rad, step_m = math.atan2(fit.slope[1], fit.slope[0]), STEP_M
        if fit.summit is not None:
            step_m = min(STEP_M, max(fit.summit.distance_m(here), PROBE_M))
        for aside_rad in ANYWHERE_RAD:
            goal = _off(here, step_m, yaw_rad + aside_rad)
            if goal.distance_m(self._task.place) > self._seek.reach_m:
                continue
            yield from self._drive(goal)
            if self.travel.place().distance_m(here) >= MOVED_M:
                return

    def _on_spiral(self, turn: int) -> Point2D:
        """Next place to measure in a flat field (Failed beyond the reach)."""
        radius_m = SPIRAL_M * (1.0 + math.sqrt(turn))
        if radius_m > self._seek.reach_m:
            raise Failed(f"{self._seek.quantity} rises nowhere within {self._seek.reach_m:g} m")
        return _off(self._task.place, radius_m, turn * GOLDEN_RAD)

    def _drive(self, goal: Point2D) -> Drive:
        """Go there, sensing on the path; False if that is not possible."""
        travel = self.travel
        if not travel.set_out(goal, priority=self._task.priority):
            yield
            return False
        while (progress := travel.step()) is not TravelState.ARRIVED:
            if progress is TravelState.LOST:
                raise Failed(TROUBLE[progress])
            if progress in TROUBLE:
                travel.stop()
                yield
                return False
            self._sample(self.travel.place())
            self._check_time()
            yield
        self._sample(self.travel.place())
        return True

    def _sample(self, here: Point2D) -> None:
        now_ns = self.env.clock.now_ns()
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + to_ns(SAMPLE_S)
        try:
            value = self._board.measure().values.get(self._seek.quantity)
        except CallError:
            value = None
        if value is not None:
            self._samples += 1
            self._field.add(here, value, to_seconds(now_ns))
        for reading in [received.message for received in self._readings.drain()]:
            sensed_ns = measured_at_ns(reading)
            is_meant = reading.quantity == self._seek.quantity and now_ns - sensed_ns < to_ns(RECEIVED_S)
            if is_meant and reading.place is not None and reading.place.distance_m(here) < self._seek.reach_m:
                self._received += 1
                self._field.receive(reading.mote, reading.place, reading.value, to_seconds(sensed_ns))

    def _fit(self, at: Point2D, width_m: float = WIDTH_M) -> FieldFit | None:
        return self._field.fit(at, to_seconds(self.env.clock.now_ns()), width_m)

    def _check_time(self) -> None:
        if self.env.clock.now_ns() > self._until_ns:
            raise Failed(f"no source of {self._seek.quantity} was found in {self._seek.duration_s:g} s")


def _off(place: Point2D, distance_m: float, yaw_rad: float) -> Point2D:
    return Point2D(place.x_m + distance_m * math.cos(yaw_rad), place.y_m + distance_m * math.sin(yaw_rad))
