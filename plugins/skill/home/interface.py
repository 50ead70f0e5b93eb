"""What home offers."""

from typing import Protocol

import msgspec

from robrain.agent.event import Event
from robrain.protocol.model.geometry import Point2D


class ChargerPlace(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where a robot's centre has to be to be charged, arena frame, and how it has to face if that matters."""

    x_m: float
    y_m: float
    yaw_rad: float | None = None

    @property
    def place(self) -> Point2D:
        """The same without the yaw."""
        return Point2D(self.x_m, self.y_m)


class HomeInterface(Protocol):
    """The chargers that the robot knows, and the place that it started from."""

    asked: Event[str]
    """The robot should go home now; why."""

    def chargers(self) -> list[ChargerPlace]:
        """All that are known; those of the manifest first."""

    def learn(self, charger: ChargerPlace) -> None:
        """Know one more, as from a task; one that is known already is not taken twice."""

    def start(self) -> Point2D | None:
        """Where the robot started, arena frame, as far as it knows now; None before it knows where it is."""

    def ask(self, why: str) -> None:
        """Say that the robot should go home; whoever drives it there observes `asked`."""
