"""Where the cameras of the arena's robots are asked for a picture: the topic `arena/ROBOT/camera`."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.mapping.occupancy_grid import GridGeometry
from robrain.protocol.wire.endpoint import Endpoint, Request
from robrain.protocol.wire.topics import ARENA_CAMERA
from robrain.sim.robot.camera import Camera, CameraSpec, SeenMote, SeenRobot
from robrain.sim.robot.robot_body import RobotBody


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
