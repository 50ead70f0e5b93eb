"""Docks: which chargers others have, as far as they tell, and who waits for one."""

from collections.abc import Sequence

from robrain.plugins.behavior.travel import Travel
from robrain.plugins.skill.home.interface import ChargerPlace
from robrain.plugins.unit.teammates.interface import Mate
from robrain.protocol.model.geometry import Point2D

AT_DOCK_M = 0.5
"""Who is, or is bound, so near to a charger has it; two chargers do not stand nearer to each other."""
RECHARGES = "recharge"
"""What the behavior of a robot that charges, or wants to, is called."""


class Docks:
    """Who has which charger, and who goes to which, with nobody to ask.

    Of two that are bound for the same charger the nearer one has it; of two equally near, the first by name.

    Args:
        robot: the robot's name.
        travel: knows where it is, and the mates.

    """

    def __init__(self, robot: str, travel: Travel) -> None:
        self._robot = robot
        self._travel = travel

    def holder(self, place: Point2D) -> str:
        """Who stands at the charger at this place, or will be there before this robot; empty if nobody."""
        mine = (self._travel.pose().distance_m(place), self._robot)
        for mate in self._travel.teammates.mates(place, AT_DOCK_M):
            away_m = mate.pose.distance_m(place)
            if away_m <= AT_DOCK_M < mine[0]:
                return mate.name
            if _is_near(mate.bound, place) and (away_m, mate.name) < mine:
                return mate.name
        return ""

    def free(self, chargers: Sequence[ChargerPlace]) -> list[ChargerPlace]:
        """Those that nobody has."""
        return [charger for charger in chargers if not self.holder(charger.place)]

    def waiting(self, chargers: Sequence[ChargerPlace]) -> list[Mate]:
        """Mates that want to charge and have no charger."""
        pose = self._travel.pose()
        near = self._travel.teammates.mates(Point2D(pose.x_m, pose.y_m), self._travel.mate_near_m)
        return [mate for mate in near if mate.behavior == RECHARGES and not _has_one(mate, chargers)]

    def charging(self, chargers: Sequence[ChargerPlace]) -> list[Mate]:
        """Mates that stand at a charger."""
        found = {mate.name: mate for each in chargers for mate in self._travel.teammates.mates(each.place, AT_DOCK_M)}
        return [
            mate for mate in found.values() if any(mate.pose.distance_m(each.place) <= AT_DOCK_M for each in chargers)
        ]


def _has_one(mate: Mate, chargers: Sequence[ChargerPlace]) -> bool:
    return any(mate.pose.distance_m(each.place) <= AT_DOCK_M or _is_near(mate.bound, each.place) for each in chargers)


def _is_near(one: Point2D, other: Point2D) -> bool:
    return (one.x_m - other.x_m) ** 2 + (one.y_m - other.y_m) ** 2 <= AT_DOCK_M**2
