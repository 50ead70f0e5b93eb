"""Home: what a robot knows of chargers and of where it started, in one place for all behaviors."""

import math

import msgspec

from robrain.agent.event import Event
from robrain.agent.plugin import Skill, external
from robrain.plugins.skill.home.interface import ChargerPlace, HomeInterface
from robrain.protocol.model.geometry import Point2D

SAME_M = 0.3
"""Two chargers nearer to each other than this are one."""
MAX_CHARGERS = 256


class Home(Skill):
    """Knows the chargers and the robot's start."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """The chargers that the robot knows from the beginning."""

        chargers: list[ChargerPlace] = []

        def __post_init__(self) -> None:
            for charger in self.chargers:
                if not (math.isfinite(charger.x_m) and math.isfinite(charger.y_m)):
                    raise ValueError(f"expected chargers at finite places, got {charger}")

    interface = HomeInterface
    parameters: Parameters
    asked = Event[str](outside=True)

    def init(self) -> None:
        self._chargers = list(self.parameters.chargers)
        self._tell()

    @external
    def chargers(self) -> list[ChargerPlace]:
        """All known chargers."""
        return list(self._chargers)

    @external
    def learn(self, charger: ChargerPlace) -> None:
        """Add a charger."""
        is_new = all(math.hypot(charger.x_m - known.x_m, charger.y_m - known.y_m) >= SAME_M for known in self._chargers)
        if is_new and len(self._chargers) < MAX_CHARGERS:
            self._chargers.append(charger)
            self._tell()

    @external
    def start(self) -> Point2D | None:
        """Start of the robot: the origin of its dead reckoning."""
        T_arena_odom = self.env.board.T_arena_odom
        return None if T_arena_odom is None else Point2D(T_arena_odom.x_m, T_arena_odom.y_m)

    @external
    def ask(self, why: str) -> None:
        """Ask the robot to go home, with a reason."""
        self.asked.notify(why)

    def _tell(self) -> None:
        self.env.board.chargers = tuple(charger.place for charger in self._chargers)
