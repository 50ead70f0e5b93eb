"""A kind of task of your own: a robot mows a rectangle in lanes."""

import math
from collections.abc import Generator
from typing import Annotated, Any

from msgspec import Meta

from robrain import Errand, Point2D, Task, TaskParameters, Work

Side = Annotated[float, Meta(gt=0, le=20)]


class Mow(TaskParameters, frozen=True, kw_only=True):
    """Drive lanes over a rectangle whose corner with the least x and y is the task's place. Result: `lanes`."""

    width_m: Side
    """Along x, the direction of the lanes."""
    height_m: Side
    lane_m: Annotated[float, Meta(ge=0.1, le=5)] = 0.4
    """Greatest distance between two lanes."""


class MowBehavior(Errand[Mow]):
    """Mows a rectangle in lanes."""

    kind = "mow"

    def work(self, task: Task, mow: Mow) -> Work:
        """All lanes, and the paths between them."""
        return Work(path_m=_lanes(mow) * mow.width_m + mow.height_m)

    def do(self, task: Task, mow: Mow) -> Generator[None, None, dict[str, Any]]:
        """Drive to both ends of each lane, from alternating sides."""
        lanes = _lanes(mow)
        for lane in range(lanes):
            y_m = task.place.y_m + lane * mow.height_m / max(1, lanes - 1)
            for end in (lane % 2, 1 - lane % 2):
                yield from self.go(Point2D(task.place.x_m + end * mow.width_m, y_m))
        return {"lanes": lanes}


def _lanes(mow: Mow) -> int:
    return 1 + math.ceil(mow.height_m / mow.lane_m)
