"""Where sensor boards and cameras of the arena's robots are asked: the topics `arena/ROBOT/sense` and `…/camera`."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.mapping.grid_geometry import GridGeometry
from robrain.protocol.tinyos.payloads import Quantity
from robrain.protocol.wire.endpoint import Endpoint, Request
from robrain.protocol.wire.topics import ARENA_CAMERA, ARENA_SENSE
from robrain.sim.motes.field import Field
from robrain.sim.robot.camera import Camera, CameraSpec, SeenMote, SeenRobot
from robrain.sim.robot.robot_body import RobotBody


class SensorDesk:
    """Answers with what a robot's board measures at the moment, with the noise of a mote's.

    As with pictures, the noise comes from the time and the robot alone: who asks, and how often, changes nothing.

    Args:
        names: of the robots.
        bodies: where they are, in the same order.
        field: what is sensed.
        endpoint: where it is asked.
        rng: source of the noise.
        moment: counts the ticks.
        tick_s: how long one is.

    """

    def __init__(
        self,
        names: Sequence[str],
        bodies: Sequence[RobotBody],
        field: Field,
        endpoint: Endpoint,
        rng: np.random.Generator,
        moment: Callable[[], int],
        tick_s: float,
    ) -> None:
        self._index = {name: index for index, name in enumerate(names)}
        self._seeds = rng.integers(1 << 32, size=len(names)).tolist()
        self._bodies = bodies
        self._field = field
        self._moment = moment
        self._tick_s = tick_s
        for name in names:
            endpoint.answer(ARENA_SENSE, self._answer, robot=name)

    def values(self, robot: str) -> dict[str, float]:
        """What a robot measures now, by the wire's names (KeyError: no such robot)."""
        own, moment = self._index[robot], self._moment()
        body = self._bodies[own]
        place = Point2D(body.x_m, body.y_m)
        noise = np.random.default_rng([self._seeds[own], moment]).standard_normal(len(Quantity)).tolist()
        measured = {}
        for quantity, one in zip(Quantity, noise, strict=True):
            true = self._field.value(quantity, place, moment * self._tick_s)
            measured[quantity.wire_name] = round(true + self._field.spec.levels(quantity).noise * one, 3)
        return measured

    def _answer(self, request: Request[Any]) -> dict[str, float]:
        return self.values(request.names["robot"])


class CameraDesk:
    """Answers with a PNG of what a robot sees at the moment. Nothing is drawn unless somebody asks.

    Args:
        names: of the robots.
        specs: their cameras.
        bodies: where they are; all three in the same order.
        motes: what else may be in view.
        walls: (H, W) what is solid.
        geometry: where `walls` lies in the arena frame.
        endpoint: where it is asked.
        rng: source of the pictures' noise.
        moment: counts the ticks.
        chargers: where mats lie, arena frame.

    """

    def __init__(
        self,
        names: Sequence[str],
        specs: Sequence[CameraSpec],
        bodies: Sequence[RobotBody],
        motes: Sequence[SeenMote],
        walls: NDArray[np.bool_],
        geometry: GridGeometry,
        endpoint: Endpoint,
        rng: np.random.Generator,
        moment: Callable[[], int],
        chargers: Sequence[Point2D] = (),
    ) -> None:
        self._index = {name: index for index, name in enumerate(names)}
        seeds = rng.integers(1 << 32, size=len(names)).tolist()
        self._cameras = [Camera(spec, walls, geometry, seed, chargers) for spec, seed in zip(specs, seeds, strict=True)]
        self._bodies = bodies
        self._motes = motes
        self._moment = moment
        for name in names:
            endpoint.answer(ARENA_CAMERA, self._answer, robot=name)

    def png(self, robot: str) -> bytes:
        """What a robot sees now (KeyError: no such robot)."""
        own = self._index[robot]
        others = [SeenRobot(index, body.pose, body.radius_m) for index, body in enumerate(self._bodies) if index != own]
        return self._cameras[own].png(self._bodies[own].pose, others, self._motes, self._moment())

    def _answer(self, request: Request[Any]) -> bytes:
        return self.png(request.names["robot"])
