"""Home: the robot's known chargers and its start, in one place for all behaviors."""

from typing import Protocol

import msgspec

from robrain.agent.event import Event
from robrain.agent.plugin import Skill, external
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Point2D


class ChargerPlace(Checked, frozen=True, forbid_unknown_fields=True):
    """Place of a robot's centre for charging, arena frame, and its heading if that matters."""

    x_m: float
    y_m: float
    yaw_rad: float | None = None

    @property
    def place(self) -> Point2D:
        """The same without the yaw."""
        return Point2D(self.x_m, self.y_m)


class HomeInterface(Protocol):
    """The robot's known chargers, and its start."""

    asked: Event[str]
    """The robot should go home now, with the reason."""

    def chargers(self) -> list[ChargerPlace]:
        """All known chargers; those of the manifest first."""

    def learn(self, charger: ChargerPlace) -> None:
        """Add a charger, as from a task; a known one is not added twice."""

    def start(self) -> Point2D | None:
        """Estimated start of the robot, arena frame; None before it knows its place."""

    def ask(self, reason: str) -> None:
        """Request that the robot goes home; the plugin that drives it there observes `asked`."""


SAME_M = 0.3
"""Two chargers nearer to each other than this are one."""
MAX_CHARGERS = 256


class Home(Skill):
    """Knows the chargers and the robot's start."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """The chargers that are known from the beginning."""

        chargers: list[ChargerPlace] = []

    interface = HomeInterface
    parameters: Parameters
    asked = Event[str](outside=True)

    def init(self) -> None:
        self._chargers = list(self.parameters.chargers)
        self._publish()

    @external
    def chargers(self) -> list[ChargerPlace]:
        """All known chargers."""
        return list(self._chargers)

    @external
    def learn(self, charger: ChargerPlace) -> None:
        """Add a charger."""
        is_new = all(charger.place.distance_m(known.place) >= SAME_M for known in self._chargers)
        if is_new and len(self._chargers) < MAX_CHARGERS:
            self._chargers.append(charger)
            self._publish()

    @external
    def start(self) -> Point2D | None:
        """Start of the robot: the origin of its dead reckoning."""
        T_arena_odom = self.env.board.T_arena_odom
        return None if T_arena_odom is None else Point2D(T_arena_odom.x_m, T_arena_odom.y_m)

    @external
    def ask(self, reason: str) -> None:
        """Ask the robot to go home, with a reason."""
        self.asked.notify(reason)

    def _publish(self) -> None:
        self.env.board.chargers = tuple(charger.place for charger in self._chargers)
