"""Monitor: watches a room, the paper's example. Looks around at intervals and tells what is not as it was."""

import math

import msgspec

from robrain.agent.errors import HardwareAbsent
from robrain.agent.event import Event
from robrain.plugins.behavior.errand import Errand, Script
from robrain.plugins.behavior.image_out import ImageOut
from robrain.plugins.behavior.monitor.picture_change import VIEW_RAD, changed_share, colors_of
from robrain.plugins.behavior.travel import TravelParameters
from robrain.plugins.device.camera.interface import CameraInterface
from robrain.plugins.skill.energy.interface import Work
from robrain.protocol.model.numeric.kernel_array import Floats
from robrain.protocol.model.ranges import check_positive
from robrain.protocol.model.tasks.stock_kinds import MONITOR, Monitor
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.wire.clock import to_ns, to_seconds

TOLD_IMAGES = 6
"""A result names so many pictures; all have been told as events."""


class RoomChange(msgspec.Struct, frozen=True, kw_only=True):
    """Something in a room is not as it was when the robot last looked that way."""

    task: str
    image: str
    """Key of the picture."""
    yaw_rad: float
    """Where the robot looked, arena frame."""
    share: float
    """Of the picture that has changed."""


class MonitorBehavior(Errand[Monitor]):
    """Looks around at intervals and reports changes."""

    class Parameters(TravelParameters, frozen=True, forbid_unknown_fields=True):
        """When a picture counts as changed; chosen."""

        settle_s: float = 0.4
        """Time for which the robot stands after a turn before it takes a picture."""
        changed_share: float = 0.002
        view_rad: float = VIEW_RAD
        """The camera's horizontal angle of view."""

        def __post_init__(self) -> None:
            super().__post_init__()
            check_positive(self, "settle_s")
            if not 0 < self.view_rad < math.pi:
                raise ValueError(f"expected view_rad above 0 and below a half turn, got {self.view_rad}")
            if not 0 < self.changed_share < 1:
                raise ValueError(f"expected changed_share above 0 and below 1, got {self.changed_share}")

    kind = MONITOR
    parameters: Parameters
    changed = Event[RoomChange](outside=True)

    def activate(self) -> None:
        try:
            import PIL  # noqa: F401 - only to see whether it is installed: an optional dependency
        except ModuleNotFoundError as error:
            why = "pictures cannot be compared without pillow: pip install 'robrain[camera]'"
            raise HardwareAbsent(self.env.plugin, why) from error
        self._camera = self.env.use("camera", CameraInterface)
        self._images = ImageOut(self.env)
        super().activate()

    def work(self, task: Task, monitor: Monitor) -> Work:
        """A full turn each round, and standing."""
        rounds = math.ceil(monitor.duration_s / monitor.interval_s)
        return Work(turn_rad=rounds * math.tau, wait_s=monitor.duration_s)

    def do(self, task: Task, monitor: Monitor) -> Script:
        """Look around, again and again. Result: `rounds`, `changes`, `images`."""
        yaws_rad = [view * math.tau / monitor.views for view in range(monitor.views)]
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
                    images = [*images, image][-TOLD_IMAGES:]
                    yaw_now_rad = self.travel.pose().yaw_rad
                    self.changed.notify(RoomChange(task=task.id, image=image, yaw_rad=yaw_now_rad, share=share))
            rounds += 1
            next_ns = max(next_ns + to_ns(monitor.interval_s), self.env.clock.now_ns())
        yield from self.wait(to_seconds(until_ns - self.env.clock.now_ns()))
        return {"rounds": rounds, "changes": changes, "images": images}
