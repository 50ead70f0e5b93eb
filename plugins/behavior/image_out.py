"""Image out: publishes pictures under keys of their own, so that a task's result need only name the key."""

from robrain.agent.environment import Environment
from robrain.plugins.device.camera.interface import Picture
from robrain.protocol.links.publisher import Publisher
from robrain.protocol.table.topics import ROBOT_IMAGE

SLOTS = 16
"""A behavior's keys are used in turn: late joiners get its last so many pictures, a recording has all."""


class ImageOut:
    """Where a behavior's pictures leave the robot; made again in each `activate`.

    Args:
        env: the behavior's.

    """

    def __init__(self, env: Environment) -> None:
        self._env = env
        self._taken = 0
        self._publishers: dict[str, Publisher] = {}

    def put(self, picture: Picture) -> str:
        """Publish a picture; the key that it has, until so many others were published."""
        image = f"{self._env.plugin}-{self._taken % SLOTS}"
        self._taken += 1
        if image not in self._publishers:
            self._publishers[image] = self._env.wire.publisher(ROBOT_IMAGE, robot=self._env.robot, image=image)
        publisher = self._publishers[image]
        publisher.put_bytes(picture.png)
        return publisher.key
