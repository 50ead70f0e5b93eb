"""Docking: onto the contacts of a charger, and on them until the battery is full enough.

What counts is the current: where a robot believes to be is some centimetres off, more with wheels that slip.
"""

import math
from collections.abc import Callable, Generator
from typing import Any

from robrain.plugins.behavior.errand import Errand, Failed, Part
from robrain.plugins.skill.home.interface import ChargerPlace
from robrain.plugins.unit.driver.interface import Motion
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.wire.clock import to_ns

DOCKED_M = 0.05
DOCK_TRIES = 3
TOUCH_S = 2.0
"""Having docked, the robot waits so long for the first current before it looks for the contacts around."""
SEEK_RINGS = ((0.2, 6), (0.4, 8), (0.6, 12))
"""Where a dock is looked for that is not quite in its place: metres around it, and how many places. As dense as is
needed for contacts that reach 0.25 m."""
SEEK_WAIT_S = 1.2
SEEK_BLOCKED_S = 0.6
GIVE_S = 2.0
"""How often it is looked whether a mate needs the charger more."""


class Docking:
    """At one charger.

    Args:
        errand: the behavior.
        charger: where.
        no_power_s: a charger that has given nothing for so long gives nothing.

    """

    def __init__(self, errand: Errand[Any], charger: ChargerPlace, no_power_s: float) -> None:
        self._errand = errand
        self._charger = charger
        self._no_power_ns = to_ns(no_power_s)
        self.has_charged = False
        """A current has come."""

    def dock(self) -> Part:
        """Stand at the charger's place, as well as localisation can tell; the last word has the current."""
        for _ in range(DOCK_TRIES):
            yield from self._approach(self._charger.place)
            if self._errand.away_m(self._charger.place) <= DOCKED_M:
                break
        yield from self._feel(TOUCH_S)

    def charge(self, until_soc: float, must_give: Callable[[ChargerPlace], bool]) -> Generator[None, None, bool]:
        """Stay until there is enough, or nothing has come for a while; True if the place is to be given to a mate."""
        clock = self._errand.env.clock
        has_sought, last_ns = False, clock.now_ns()
        look_ns = last_ns
        while (battery := self._errand.battery()).soc < until_soc:
            now_ns = clock.now_ns()
            if battery.charging:
                self.has_charged, last_ns = True, now_ns
                if now_ns >= look_ns:
                    look_ns = now_ns + to_ns(GIVE_S)
                    if must_give(self._charger):
                        return True
            elif not self.has_charged and not has_sought:
                has_sought = True
                yield from self._seek()
                last_ns = clock.now_ns()
            elif now_ns - last_ns > self._no_power_ns:
                return False
            yield
        return False

    def _seek(self) -> Part:
        """Try places around the dock, from the inside out."""
        place, driver = self._charger.place, self._errand.travel.driver
        for radius_m, places in SEEK_RINGS:
            for index in range(places):
                angle_rad = index * math.tau / places
                self._set_out(
                    Point2D(place.x_m + radius_m * math.cos(angle_rad), place.y_m + radius_m * math.sin(angle_rad))
                )
                yield
                while driver.motion() is not Motion.STANDING and driver.blocked_s() < SEEK_BLOCKED_S:
                    yield
                if driver.motion() is not Motion.STANDING:  # there is something there
                    driver.stop()
                    continue
                yield from self._feel(SEEK_WAIT_S)
                if self._errand.battery().charging:
                    return

    def _feel(self, seconds: float) -> Part:
        """Stand until a current comes, for so long at the most."""
        until_ns = self._errand.env.clock.now_ns() + to_ns(seconds)
        while self._errand.env.clock.now_ns() < until_ns and not self._errand.battery().charging:
            yield

    def _approach(self, place: Point2D) -> Part:
        self._set_out(place)
        yield from self._errand.stand("the robot does not get into the dock")

    def _set_out(self, place: Point2D) -> None:
        travel = self._errand.travel
        T_arena_odom = self._errand.env.board.T_arena_odom
        if T_arena_odom is None:
            raise Failed("the robot does not know where it is")
        yaw_rad = self._charger.yaw_rad
        facing_rad = yaw_rad if yaw_rad is not None else travel.pose().yaw_rad
        at = T_arena_odom.inverse().compose(Pose2D(place.x_m, place.y_m, facing_rad))
        travel.driver.go_to(at.x_m, at.y_m, at.yaw_rad)
