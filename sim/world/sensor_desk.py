"""Where the sensor boards of the arena's robots are asked: the topic `arena/ROBOT/sense`."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.tinyos.payloads import Quantity
from robrain.protocol.wire.endpoint import Endpoint, Request
from robrain.protocol.wire.topics import ARENA_SENSE
from robrain.sim.motes.field import Field
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
