"""What a robot explores while no coordinator is heard: its part of what the whole team would be given.

Each robot decides for the whole team as a coordinator does, on its own map, with the places and paths that the others
publish, and takes its own part. Maps are nearly equal, and a goal is only changed for a clearly better one, so robots
conclude nearly the same. If two are bound for the same frontier, both see that, and both conclude which of them has
to give way.
"""

import math
from collections.abc import Sequence

from robrain.agent.board import IDLE, Board
from robrain.plugins.unit.teammates.interface import Doing, Mate
from robrain.protocol.exploration.explorer import Explorer, Scout
from robrain.protocol.exploration.reach import reach_m
from robrain.protocol.exploration.situation import Busy
from robrain.protocol.exploration.strategies import Strategy
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.mapping.occupancy_grid import OccupancyGrid

CONFIDENCE = 0.95
"""One-sided, of the energy that a path takes: that of plans."""
ALONE = "explore alone"
"""What the board says of a robot that explores by its own choice."""


class OwnFloor:
    """What is known of the floor, as the robot has it.

    Args:
        board: the robot's.

    """

    def __init__(self, board: Board) -> None:
        self._board = board

    @property
    def grid(self) -> OccupancyGrid | None:
        """The map; None before anything is known."""
        return self._board.map

    @property
    def version(self) -> int:
        """Grows whenever the class of a cell changes; 0 while nothing is known."""
        return 0 if self._board.map is None else self._board.map.version


class TeamChoice:
    """Chooses frontiers for a robot that hears its mates and no coordinator.

    Args:
        robot: its name.
        board: the robot's.
        strategy: which robot is sent to which frontier; the same for all robots of the team.
        reserve_share: share of the battery that the robot keeps on its way to a frontier and on to a charger.

    """

    def __init__(self, robot: str, board: Board, strategy: Strategy, reserve_share: float) -> None:
        self._robot = robot
        self._board = board
        self._reserve_share = reserve_share
        self._explorer = Explorer(OwnFloor(board), strategy)

    def choose(
        self, place: Point2D, radius_m: float, goal: Point2D | None, mates: Sequence[Mate], now_ns: int
    ) -> Point2D | None:
        """The frontier to go to, arena frame; None if there is none, or the robot is to keep the one it has.

        Args:
            place: where the robot is.
            radius_m: its radius.
            goal: the frontier that it is on its way to; None if it has none.
            mates: the other robots.
            now_ns: the time.

        """
        scouts = [self._own(place, radius_m, goal), *(_scout(mate) for mate in mates if _explores(mate))]
        busy = [
            Busy(Point2D(mate.pose.x_m, mate.pose.y_m), mate.bound)
            for mate in mates
            if mate.doing is not Doing.OBSTACLE and not _explores(mate)
        ]
        chosen = self._explorer.choose(sorted(scouts), busy, now_ns)
        return next((choice.place for choice in chosen if choice.robot == self._robot), None)

    def _own(self, place: Point2D, radius_m: float, goal: Point2D | None) -> Scout:
        """The robot itself, which knows how far its energy lasts; how far that of others does, they know."""
        board, homes = self._board, self._board.chargers
        far_m = math.inf
        if homes:
            far_m = reach_m(board.energy, board.battery, reserve_share=self._reserve_share, confidence=CONFIDENCE)
        return Scout(self._robot, place, radius_m, goal, far_m, homes)

    def note_visit(self, goal: Point2D) -> None:
        """The robot has been at a frontier: what it has not seen of the unknown there, it will not see later."""
        self._explorer.note_visit(goal)

    def note_failure(self, goal: Point2D, now_ns: int) -> None:
        """The robot could not get to a frontier, and avoids it for a while."""
        self._explorer.note_failure(self._robot, goal, now_ns)

    def note_gap(self, place: Point2D, gap_m: object, now_ns: int) -> None:
        """The robot, which is at `place`, does not fit through a gap of this width."""
        self._explorer.note_gap(place, gap_m, now_ns)


def _explores(mate: Mate) -> bool:
    """Whether a mate chooses its goal by itself as well, and may yet choose another."""
    return mate.doing is not Doing.OBSTACLE and mate.behavior in (ALONE, IDLE)


def _scout(mate: Mate) -> Scout:
    place = Point2D(mate.pose.x_m, mate.pose.y_m)
    return Scout(mate.name, place, mate.radius_m, mate.bound if mate.behavior == ALONE else None)
