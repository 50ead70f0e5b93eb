"""Fake of the behavior that the parts of `recharge` use, made of plain objects that the test sets."""

import math
from types import SimpleNamespace
from typing import Any, cast

from robrain.plugins.behavior.budget import Docks
from robrain.plugins.behavior.errand import Errand
from robrain.plugins.behavior.travel import TravelState
from robrain.plugins.skill.home import ChargerPlace
from robrain.plugins.unit.driver.interface import Motion
from robrain.plugins.unit.teammates import Doing, NearbyRobot
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.model.claim import Claim
from robrain.protocol.model.geometry import Point2D, Pose2D


class BareDriver:
    """Arrives at once, unless the test makes it drive on or blocks it."""

    def __init__(self) -> None:
        self.sent: list[Pose2D] = []
        self.state = Motion.STOPPED
        self.blocked = 0.0
        self.stops = 0

    def go_to(self, x_m: float, y_m: float, yaw_rad: float) -> str:
        self.sent.append(Pose2D(x_m, y_m, yaw_rad))
        return f"go_to-{len(self.sent)}"

    def motion(self) -> Motion:
        return self.state

    def blocked_s(self) -> float:
        return self.blocked

    def stop(self) -> None:
        self.stops += 1

    def radius_m(self) -> float:
        return 0.2


class BareErrand:
    """A charging behavior: pose, battery, other robots, and its recorded actions."""

    def __init__(self, *chargers: ChargerPlace) -> None:
        self.clock = VirtualClock(to_ns(1000.0))
        self.at = Pose2D(0.0, 0.0, 0.0)
        self.others: list[NearbyRobot] = []
        self.soc, self.charging = 0.5, False
        self.usable_j, self.usual_power_w = 6000.0, 10.0
        self.planned: list[Point2D] = []
        """Goals for which the planner was asked for a path."""
        self.no_way_to: list[Point2D] = []
        self.gone: list[Point2D] = []
        self.set_out: list[tuple[Point2D, int]] = []
        self.progress: list[TravelState] = []
        """Results of the next travel steps; after them it arrives."""
        self.stands = self.made_room = 0
        self.driver = BareDriver()
        self.travel: Any = SimpleNamespace(
            driver=self.driver,
            pose=lambda: self.at,
            place=lambda: Point2D(self.at.x_m, self.at.y_m),
            teammate_near_m=8.0,
            teammates=SimpleNamespace(nearby=self._others),
            plan=self._plan,
            set_out=self._set_out,
            step=lambda: self.progress.pop(0) if self.progress else TravelState.ARRIVED,
            stop=self._stop,
            make_room=self._make_room,
        )
        self.board = SimpleNamespace(T_arena_odom=Pose2D(0.0, 0.0, 0.0), energy=None, battery=None)
        self.board.energy = SimpleNamespace(usable_j=6000.0, usual_power_w=10.0)
        self.env: Any = SimpleNamespace(clock=self.clock, board=self.board, robot="r5")
        self.chargers = list(chargers)
        self.budget: Any = SimpleNamespace(
            docks=Docks("r5", self.travel),
            home=SimpleNamespace(chargers=lambda: self.chargers),
            routes=lambda place, free: [(one, math.dist((place.x_m, place.y_m), (one.x_m, one.y_m))) for one in free],
        )

    def battery(self) -> Any:
        return SimpleNamespace(soc=self.soc, charging=self.charging)

    def away_m(self, place: Point2D) -> float:
        return self.at.distance_m(place)

    def go(self, goal: Point2D) -> Any:
        self.gone.append(goal)
        yield

    def arrive(self, _trouble: str) -> Any:
        yield

    def settle(self) -> Any:
        return Errand.settle(cast(Errand, self))

    def _now_ns(self) -> int:
        return self.clock.now_ns()

    def wait(self, seconds: float) -> None:
        self.clock.advance_to(self.clock.now_ns() + to_ns(seconds))

    def _others(self, place: Point2D, near_m: float) -> list[NearbyRobot]:
        return [
            other
            for other in self.others
            if min(other.pose.distance_m(place), math.dist((other.bound.x_m, other.bound.y_m), (place.x_m, place.y_m)))
            <= near_m
        ]

    def _plan(self, goal: Point2D) -> list[Point2D] | None:
        self.planned.append(goal)
        return None if goal in self.no_way_to else [goal]

    def _set_out(self, goal: Point2D, *, priority: int) -> bool:
        self.set_out.append((goal, priority))
        return goal not in self.no_way_to

    def _stop(self) -> None:
        self.stands += 1

    def _make_room(self) -> None:
        self.made_room += 1


def other(name: str, x_m: float, y_m: float, bound: Point2D | None = None, **fields: Any) -> NearbyRobot:
    """Another robot that stands, or drives to a place."""
    return NearbyRobot(
        name=name,
        pose=Pose2D(x_m, y_m, 0.0),
        radius_m=0.2,
        doing=Doing.IDLE,
        claim=Claim(),
        track=None,  # of no interest here
        task="",
        bound=bound or Point2D(x_m, y_m),
        **fields,
    )


def run(script: Any, steps: int = 1000) -> Any:
    """Run a script to its end or for a number of steps; its result, or ... if it is still running."""
    for _ in range(steps):
        try:
            next(script)
        except StopIteration as end:
            return end.value
    return ...
