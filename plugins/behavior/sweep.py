"""Sweep: drives over an area in lanes."""

import itertools

import numpy as np

from robrain.algorithms.navigation.area_coverage import Lane, covered_share, floor_of, lanes_over, ordered_lanes
from robrain.plugins.behavior.errand import Errand, Failed, Script
from robrain.plugins.skill.energy import Work
from robrain.plugins.skill.planner import PlannerInterface
from robrain.protocol.model.tasks.stock_kinds import SWEEP, Sweep
from robrain.protocol.model.tasks.task import Task

MARK_M = 0.1
"""Distance between the recorded positions of the robot."""


class SweepBehavior(Errand[Sweep]):
    """Drives over an area in lanes, in the order of its boustrophedon decomposition."""

    kind = SWEEP

    def activate(self) -> None:
        self._planner = self.env.use("planner", PlannerInterface)
        self._lanes: tuple[Task, list[Lane]] | None = None
        super().activate()

    def work(self, task: Task, sweep: Sweep) -> Work:
        """The lanes, and the straight lines between them."""
        lanes = self.lanes(task, sweep)
        ends = [task.place, *itertools.chain.from_iterable(lanes)]
        return Work(path_m=sum(start.distance_m(end) for start, end in itertools.pairwise(ends)), ends_at=ends[-1])

    def do(self, task: Task, sweep: Sweep) -> Script:
        """Drive each lane; a lane that is blocked is left out. Result: `covered_share`, `lanes`."""
        self._lanes = None
        lanes = self.lanes(task, sweep)
        positions, swept, trouble = [self.travel.place()], 0, "no path leads over the area"
        for lane in lanes:
            try:
                for end in lane:
                    for _ in self.go(end):
                        if self.away_m(positions[-1]) > MARK_M:
                            positions.append(self.travel.place())
                        yield
                swept += 1
            except Failed as failed:
                trouble = str(failed)
        if not swept:
            raise Failed(trouble)
        grid = self._planner.grid(self.travel.view())
        driven = np.array([(position.x_m, position.y_m) for position in positions])
        floor = floor_of(sweep.area, grid.traversable, grid.geometry)
        return {"covered_share": round(covered_share(floor, grid.geometry, driven, sweep.width_m), 3), "lanes": swept}

    def lanes(self, task: Task, sweep: Sweep) -> list[Lane]:
        """The lanes over an area on the map as it was when the task was first seen, in the order to drive them."""
        if self._lanes is None or self._lanes[0] != task:
            grid = self._planner.grid(self.travel.view())
            strips = lanes_over(
                sweep.area, floor_of(sweep.area, grid.traversable, grid.geometry), grid.geometry, sweep.width_m
            )
            self._lanes = task, ordered_lanes(strips, task.place, self.budget.lengths_m)
        return self._lanes[1]
