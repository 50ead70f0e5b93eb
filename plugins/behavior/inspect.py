"""Inspect: goes to a place, looks, and publishes what the camera saw."""

import math

from robrain.plugins.behavior.errand import Errand, Script
from robrain.plugins.behavior.image_out import ImageOut
from robrain.plugins.device.camera.interface import CameraInterface
from robrain.plugins.skill.energy.interface import Work
from robrain.protocol.model.tasks.stock_kinds import INSPECT, Inspect
from robrain.protocol.model.tasks.task import Task

STEADY_S = 0.4
"""Before the picture is taken the robot stands for so long."""


class InspectBehavior(Errand[Inspect]):
    """Takes a picture at a place."""

    kind = INSPECT

    def activate(self) -> None:
        self._camera = self.env.use("camera", CameraInterface)
        self._images = ImageOut(self.env)
        super().activate()

    def work(self, task: Task, inspect: Inspect) -> Work:
        """At the most half a turn, and standing."""
        return Work(turn_rad=math.pi if inspect.look_at is not None else 0.0, wait_s=STEADY_S + task.service_s)

    def do(self, task: Task, inspect: Inspect) -> Script:
        """Look. Result: `image`, `yaw_rad`."""
        if inspect.look_at is not None:
            pose = self.travel.pose()
            yield from self.face(math.atan2(inspect.look_at.y_m - pose.y_m, inspect.look_at.x_m - pose.x_m))
        yield from self.wait(STEADY_S)
        key = self._images.put(self._camera.snapshot())
        yaw_rad = self.travel.pose().yaw_rad
        yield from self.wait(task.service_s)
        return {"image": key, "yaw_rad": round(yaw_rad, 3)}
