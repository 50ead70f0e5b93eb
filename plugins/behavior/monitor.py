"""Monitor and guard: watch a room, the paper's example, or an area, and report changes."""

import io
import math
from collections.abc import Sequence
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from robrain.agent.errors import HardwareAbsent
from robrain.agent.event import Event
from robrain.algorithms.navigation.area_coverage import overlook
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.plugins.behavior.errand import Errand, Failed, Script
from robrain.plugins.behavior.errands import ImageOut
from robrain.plugins.behavior.travel import TravelParameters
from robrain.plugins.device.camera import CameraInterface
from robrain.plugins.skill.energy import Work
from robrain.plugins.skill.planner import PlannerInterface
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.model.geometry import wrap_angle_rad
from robrain.protocol.model.ranges import Positive
from robrain.protocol.model.tasks.stock_kinds import GUARD, MONITOR, Guard, Monitor
from robrain.protocol.model.tasks.task import Task

HALF = 2
TURN_MAX_RAD = 0.14
"""Largest difference between the headings of two pictures."""
TURN_STEPS = 17
"""Turns that are tried first, some a pixel apart; then half of that, a quarter and an eighth."""
VIEW_RAD = 1.2
"""Horizontal angle of view that is assumed where none is known."""
CHANGED_LEVELS = 14.0
"""A pixel has changed when a colour of it differs by more than this, of 255. Chosen; the noise makes some 3."""
OUTLIER_LEVELS = 40.0
"""Limit of a difference in the agreement of two pictures: a new object must not shift them."""
SQUARE = 4
"""In pixels of the picture at half its size; remaining lines are up to three wide."""

Colors = Floats
Mask = NDArray[np.bool_]


def colors_of(png: bytes) -> Colors:
    """Colours (H / 2, W / 2, 3), 0 to 255; a picture's pixels averaged two by two.

    Raises:
        ModuleNotFoundError: pillow is not installed.
        OSError: it is no picture.

    """
    from PIL import Image  # a robot without a camera does without it

    with Image.open(io.BytesIO(png)) as picture:
        pixels: NDArray[Any] = np.asarray(picture.convert("RGB"), np.float64)
    rows, columns = pixels.shape[0] // HALF, pixels.shape[1] // HALF
    halves = pixels[: rows * HALF, : columns * HALF].reshape(rows, HALF, columns, HALF, 3)
    return np.asarray(halves.mean(axis=(1, 3)))


def changed_share(before: Colors, now: Colors, view_rad: float = VIEW_RAD) -> float:
    """Changed share of the picture, 0 to 1; 1 if the two pictures differ in size.

    Args:
        before: earlier picture, as returned by `colors_of`.
        now: later picture, in the same form.
        view_rad: the camera's horizontal angle of view.

    """
    if before.shape != now.shape:
        return 1.0
    turned, in_view = _turned(before, _turn_rad(before, now, view_rad), view_rad)
    changed = (_difference(turned, now) > CHANGED_LEVELS) & in_view
    changed[[0, -1]] = False
    return float(np.count_nonzero(_squares(changed))) / max(1, int(np.count_nonzero(in_view)))


def _turn_rad(before: Colors, now: Colors, view_rad: float) -> float:
    """Angle by which the earlier picture must be turned to agree best with the new one."""
    gray, gray_now = (colors.mean(axis=2, keepdims=True) for colors in (before, now))

    def disagreement(turn_rad: float) -> float:
        turned, in_view = _turned(gray, turn_rad, view_rad)
        return float(np.minimum(np.abs(turned - gray_now), OUTLIER_LEVELS)[in_view].mean())

    turns_rad: list[float] = np.linspace(-TURN_MAX_RAD, TURN_MAX_RAD, TURN_STEPS).tolist()
    found = {turn_rad: disagreement(turn_rad) for turn_rad in turns_rad}
    step_rad = turns_rad[1] - turns_rad[0]
    for _ in range(3):
        step_rad /= 2
        best_rad = min(found, key=found.__getitem__)
        for turn_rad in (best_rad - step_rad, best_rad + step_rad):
            found[turn_rad] = disagreement(turn_rad)
    return min(found, key=found.__getitem__)


def _turned(colors: Colors, turn_rad: float, view_rad: float) -> tuple[Colors, Mask]:
    """Image of a camera turned by this angle (positive to the right), and the mask of its known pixels."""
    rows, columns, _ = colors.shape
    focal = 0.5 * columns / math.tan(0.5 * view_rad)
    right = np.arange(columns) + 0.5 - 0.5 * columns
    down = (np.arange(rows) + 0.5 - 0.5 * rows)[:, None]
    ahead = focal - right * math.tan(turn_rad)
    across = np.broadcast_to(
        focal * (right + focal * math.tan(turn_rad)) / ahead + 0.5 * columns - 0.5, (rows, columns)
    )
    along = down * (focal / math.cos(turn_rad)) / ahead + 0.5 * rows - 0.5
    in_view = (across >= 0) & (across <= columns - 1) & (along >= 0) & (along <= rows - 1)
    left = np.clip(np.floor(across).astype(np.int64), 0, columns - 2)
    top = np.clip(np.floor(along).astype(np.int64), 0, rows - 2)
    part_x, part_y = (across - left)[..., None], (along - top)[..., None]
    upper = colors[top, left] * (1 - part_x) + colors[top, left + 1] * part_x
    lower = colors[top + 1, left] * (1 - part_x) + colors[top + 1, left + 1] * part_x
    return upper * (1 - part_y) + lower * part_y, in_view


def _difference(before: Colors, now: Colors) -> Colors:
    """(H, W) difference of each pixel from the most similar of the nine pixels at its earlier place."""
    rows, columns, _ = now.shape
    wide = np.pad(before, ((1, 1), (1, 1), (0, 0)), mode="edge")
    around = [wide[down : down + rows, across : across + columns] for down in range(3) for across in range(3)]
    least: Colors = np.min([np.abs(now - part).max(axis=2) for part in around], axis=0)
    return least


def _squares(mask: Mask) -> Mask:
    """Set pixels that lie in a square of `SQUARE` set pixels (a morphological opening)."""
    rows, columns = mask.shape[0] - SQUARE + 1, mask.shape[1] - SQUARE + 1
    steps = [(down, across) for down in range(SQUARE) for across in range(SQUARE)]
    whole = np.ones((rows, columns), np.bool_)
    for down, across in steps:
        whole &= mask[down : down + rows, across : across + columns]
    squares = np.zeros_like(mask)
    for down, across in steps:
        squares[down : down + rows, across : across + columns] |= whole
    return squares


REPORTED_IMAGES = 6
"""Number of pictures that a result names; all pictures were published as events."""


class RoomChange(msgspec.Struct, frozen=True, kw_only=True):
    """Something in a room has changed since the robot's last look in this direction."""

    task: str
    image: str
    """Key of the picture."""
    yaw_rad: float
    """Heading of the robot, arena frame."""
    share: float
    """Of the picture that has changed."""


class MonitorBehavior(Errand[Monitor]):
    """Looks around at intervals and reports changes."""

    class Parameters(TravelParameters, frozen=True, forbid_unknown_fields=True):
        """When a picture counts as changed; chosen."""

        settle_s: Positive = 0.4
        """Time that the robot stands after a turn before it takes a picture."""
        changed_share: Annotated[float, Meta(gt=0, lt=1)] = 0.002
        view_rad: Annotated[float, Meta(gt=0, lt=math.pi)] = VIEW_RAD
        """The camera's horizontal angle of view."""

    kind = MONITOR
    parameters: Parameters
    changed = Event[RoomChange](outside=True)

    def activate(self) -> None:
        try:
            import PIL  # noqa: F401 - only to see whether it is installed: an optional dependency
        except ModuleNotFoundError as error:
            reason = "pictures cannot be compared without pillow: pip install 'robrain[camera]'"
            raise HardwareAbsent(self.env.plugin, reason) from error
        self._camera = self.env.use("camera", CameraInterface)
        self._images = ImageOut(self.env)
        super().activate()

    def work(self, task: Task, monitor: Monitor) -> Work:
        """A full turn each round, and standing."""
        rounds = math.ceil(monitor.duration_s / monitor.interval_s)
        return Work(turn_rad=rounds * math.tau, wait_s=monitor.duration_s)

    def do(self, task: Task, monitor: Monitor) -> Script:
        """Look around repeatedly.

        Result: `rounds`, `changes`, `images`.
        """
        return (
            yield from self.watch(task, monitor, [view * math.tau / monitor.views for view in range(monitor.views)])
        )

    def watch(self, task: Task, monitor: Monitor, yaws_rad: Sequence[float]) -> Script:
        """Look in these directions in each round, and report changes."""
        seen: dict[float, Floats] = {}
        images: list[str] = []
        rounds = changes = 0
        next_ns = self.env.clock.now_ns()
        until_ns = next_ns + to_ns(monitor.duration_s)
        while next_ns < until_ns:
            yield from self.wait(to_seconds(next_ns - self.env.clock.now_ns()))
            for yaw_rad in yaws_rad:
                yield from self.face(yaw_rad)
                yield from self.wait(self.parameters.settle_s)
                picture = self._camera.snapshot()
                colors = colors_of(picture.png)
                share = changed_share(seen[yaw_rad], colors, self.parameters.view_rad) if yaw_rad in seen else 0.0
                seen[yaw_rad] = colors
                if share >= self.parameters.changed_share:
                    changes += 1
                    image = self._images.put(picture)
                    images = [*images, image][-REPORTED_IMAGES:]
                    yaw_now_rad = self.travel.pose().yaw_rad
                    self.changed.notify(RoomChange(task=task.id, image=image, yaw_rad=yaw_now_rad, share=share))
            rounds += 1
            next_ns = max(next_ns + to_ns(monitor.interval_s), self.env.clock.now_ns())
        yield from self.wait(to_seconds(until_ns - self.env.clock.now_ns()))
        return {"rounds": rounds, "changes": changes, "images": images}


class GuardBehavior(MonitorBehavior):
    """Stands where most of an area is seen, and reports changes there."""

    class Parameters(MonitorBehavior.Parameters, frozen=True, forbid_unknown_fields=True):
        """Range of the camera."""

        range_m: Positive = 10.0

    kind = GUARD
    task_parameters = Guard
    parameters: Parameters

    def activate(self) -> None:
        self._planner = self.env.use("planner", PlannerInterface)
        super().activate()

    def do(self, task: Task, guard: Monitor) -> Script:
        """Go where the area is seen, and watch it.

        Result: `rounds`, `changes`, `images`, `seen_share`.
        """
        assert isinstance(guard, Guard)
        view = self.travel.view()
        grid = self._planner.grid(view)
        found = overlook(view.classes, grid.traversable, grid.geometry, guard.area, self.parameters.range_m)
        if found is None:
            raise Failed("no place is known from which the area is seen")
        viewpoint, seen_share = found
        yield from self.go(viewpoint)
        at = self.travel.place()
        x_m, y_m = (sum(getattr(corner, axis) for corner in guard.area) / len(guard.area) for axis in ("x_m", "y_m"))
        ahead_rad = math.atan2(y_m - at.y_m, x_m - at.x_m)
        corners = [math.atan2(corner.y_m - at.y_m, corner.x_m - at.x_m) for corner in guard.area]
        aside_rad = [wrap_angle_rad(corner_rad - ahead_rad) for corner_rad in corners]
        low_rad, high_rad = min(aside_rad), max(aside_rad)
        shares = [(view + 0.5) / guard.views for view in range(guard.views)]
        yaws_rad = [ahead_rad + low_rad + share * (high_rad - low_rad) for share in shares]
        result = yield from self.watch(task, guard, yaws_rad)
        return {**result, "seen_share": round(seen_share, 3)}
