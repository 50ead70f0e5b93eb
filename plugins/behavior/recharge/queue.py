"""Queue: which charger a robot goes to, how it waits while others have them all, and when it makes room.

A robot that charges gives its place to one that waits before that one runs out, and comes back later: nobody is
stranded beside an occupied charger as long as the chargers together give more than the robots draw.
"""

import math

from robrain.plugins.behavior.budget import AT_DOCK_M
from robrain.plugins.behavior.errand import SETTLE_S, TROUBLE, Errand, Failed, Part, Script
from robrain.plugins.behavior.travel import PRIORITY_MAX, Progress
from robrain.plugins.skill.home.interface import ChargerPlace
from robrain.plugins.unit.driver.interface import Motion
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import Recharge
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.wire.clock import to_ns

ASIDE_M = (1.3, 2.0)
"""Who waits, or makes room, stands so far from a charger."""
CLEAR_M = 1.0
"""… and no nearer to any."""
NEAR_M = 3.0
"""Who is so near to a charger already waits where it is."""
APART_M = 0.3
"""Between the hulls of those who wait."""
DIRECTIONS = 8
LEFT_OUT_S = 60.0
"""A charger that was of no use is tried again after this."""
GIVEN_S = 20.0
"""For so long a charger that was given to a mate counts as the mate's, wherever that is."""
URGENT_S, SPARE_S, RICH_S = 150.0, 120.0, 600.0
"""A charger is given to who lasts no longer than the first, by who lasts longer by the second; or by the third in any
case. All chosen: changing places takes some 20 s."""


class Queue:
    """One robot's way to a charger.

    Args:
        errand: the behavior.
        task: its place is the charger that is wanted most.
        yaw_rad: heading of a robot docked there, arena frame; None if it is not known.

    """

    def __init__(self, errand: Errand[Recharge], task: Task, yaw_rad: float | None) -> None:
        self._errand = errand
        self._wanted = ChargerPlace(task.place.x_m, task.place.y_m, yaw_rad)
        self._priority = round(min(task.priority, PRIORITY_MAX))
        self._left_out: dict[Point2D, int] = {}
        """Until when."""
        self._given: dict[Point2D, int] = {}
        self._trouble = ""

    def choose(self) -> ChargerPlace | None:
        """The one that is wanted if nobody has it, else the nearest that nobody has; None if others have them all.

        Raises:
            Failed: none is of any use.

        """
        usable = self._usable()
        if not usable:
            raise Failed(self._trouble)
        free = self._free(usable)
        if self._wanted in free or not free:
            return self._wanted if free else None
        pose = self._errand.travel.pose()
        return min(self._errand.budget.ways(Point2D(pose.x_m, pose.y_m), free), key=lambda way: way[1])[0]

    def leave_out(self, charger: ChargerPlace, why: str) -> None:
        """It was of no use."""
        self._trouble = why
        self._left_out[charger.place] = self._now_ns() + to_ns(LEFT_OUT_S)

    def reach(self, charger: ChargerPlace) -> "Script":
        """Go there. Whether the robot is there; not if somebody else has it now, or there is no way."""
        errand = self._errand
        if not errand.travel.set_out(charger.place, priority=self._priority):
            self.leave_out(charger, TROUBLE[Progress.NO_WAY])
            return {}
        while (progress := errand.travel.step()) is not Progress.ARRIVED:
            if progress in TROUBLE:
                self.leave_out(charger, TROUBLE[progress])
            if progress in TROUBLE or errand.budget.docks.holder(charger.place):
                errand.travel.stand()
                return {}
            yield
        until_ns = self._now_ns() + to_ns(SETTLE_S)
        while errand.travel.driver.motion() is Motion.DRIVING and self._now_ns() < until_ns:
            yield
        errand.travel.stand()
        return {"reached": True}

    def wait(self) -> Part:
        """Stand near a charger, in nobody's way, until there is one that nobody has."""
        yield from self.stand_aside()
        while (usable := self._usable()) and not self._free(usable):
            self._errand.travel.make_room()
            yield
        self._errand.travel.stand()

    def must_give(self, charger: ChargerPlace) -> bool:
        """Whether a mate that waits needs a charger more, and of those who charge this robot can best do without."""
        errand = self._errand
        energy = errand.env.board.energy
        chargers = self._known()
        waiting = errand.budget.docks.waiting(chargers)
        if not waiting or energy is None:
            return False
        mine = (energy.usable_j / max(energy.usual_power_w, 0.1), errand.env.robot)
        if any((mate.endurance_s, mate.name) > mine for mate in errand.budget.docks.charging(chargers)):
            return False
        neediest_s = min(mate.endurance_s for mate in waiting)
        return mine[0] >= neediest_s + (SPARE_S if neediest_s < URGENT_S else RICH_S)

    def give_up_place(self, charger: ChargerPlace) -> Part:
        """Leave it to whoever waits."""
        self._given[charger.place] = self._now_ns() + to_ns(GIVEN_S)
        yield from self.stand_aside()

    def stand_aside(self) -> Script:
        """Go where others can get to every charger, if the robot is not at such a place."""
        place = self._aside()
        if place is not None:
            try:
                yield from self._errand.go(place)
            except Failed:
                self._errand.travel.stand()  # here, then
        return {}

    def _aside(self) -> Point2D | None:
        """The nearest place beside a charger with room to wait; None if the robot need not, or cannot, go to one."""
        travel, chargers = self._errand.travel, self._known()
        pose = travel.pose()
        nearest = min(chargers, key=lambda charger: pose.distance_m(charger.place))
        if CLEAR_M <= pose.distance_m(nearest.place) <= NEAR_M:
            return None
        here = Point2D(pose.x_m, pose.y_m)
        radius_m = travel.driver.radius_m()
        taken = [(charger.place, CLEAR_M) for charger in chargers]
        for mate in travel.teammates.mates(here, travel.mate_near_m):
            taken.append((Point2D(mate.pose.x_m, mate.pose.y_m), radius_m + mate.radius_m + APART_M))
            taken.append((mate.bound, radius_m + mate.radius_m + APART_M))
        places = [
            Point2D(nearest.x_m + away_m * math.cos(angle_rad), nearest.y_m + away_m * math.sin(angle_rad))
            for away_m in ASIDE_M
            for angle_rad in (direction * math.tau / DIRECTIONS for direction in range(DIRECTIONS))
        ]
        clear = [place for place in places if all(place.distance_m(other) >= apart_m for other, apart_m in taken)]
        for place in sorted(clear, key=pose.distance_m):
            path = travel.plan(place)
            if path and path[-1].distance_m(place) < APART_M:
                return place
        return None

    def _known(self) -> list[ChargerPlace]:
        others = self._errand.budget.home.chargers()
        return [self._wanted, *(each for each in others if each.place.distance_m(self._wanted.place) > AT_DOCK_M)]

    def _usable(self) -> list[ChargerPlace]:
        now_ns = self._now_ns()
        return [charger for charger in self._known() if self._left_out.get(charger.place, 0) <= now_ns]

    def _free(self, chargers: list[ChargerPlace]) -> list[ChargerPlace]:
        now_ns = self._now_ns()
        ours = [charger for charger in chargers if self._given.get(charger.place, 0) <= now_ns]
        return self._errand.budget.docks.free(ours)

    def _now_ns(self) -> int:
        return self._errand.env.clock.now_ns()
