"""An encounter: the mates around a robot at one moment, and who of them goes first."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robrain.plugins.skill.planner.interface import Circle
from robrain.plugins.unit.teammates.interface import Doing, Mate
from robrain.protocol.model.navigation.claim import Claim
from robrain.protocol.model.navigation.navigation_grid import Zone
from robrain.protocol.model.navigation.right_of_way import STEP_M, Margins, Release, Track, meet, release

MARGINS = Margins()
REFUGE_M = 0.22
"""Between two hulls in a refuge, chosen: what counts as out of the way, and what the driver stops short of its goal."""
ZONE_AHEAD_M = 8.0
"""A mate's way that is better left to it, chosen: as far as mates are reckoned with."""
ROOM_S = 8.0
"""Who stands idle makes room for a mate that will be there within this."""
PRESSED_S = 2.5
"""Who has no refuge says so when a mate could be there within this; before, the mate may be waiting for others."""


class Encounter:
    """Who is met, as the robot sees it.

    Args:
        robot: the robot's name.
        claim: its claim.
        radius_m: its radius.
        mates: those around it.
        speed_m_s: its speed.

    """

    def __init__(self, robot: str, claim: Claim, radius_m: float, mates: Sequence[Mate], speed_m_s: float) -> None:
        self.radius_m = radius_m
        self.mates = mates
        self._speed_m_s = speed_m_s
        self.tracks = [
            mate.track._replace(
                keep_m=mate.radius_m + radius_m,
                goes_first=mate.doing is Doing.UNDER_WAY and mate.claim.beats(mate.name, claim, robot),
            )
            for mate in mates
        ]

    def release(self, ahead: NDArray[np.float64]) -> Release:
        """How far the robot may go along positions (N, 2)."""
        return release(ahead, self._speed_m_s, self.tracks, MARGINS)

    def guard(self, ahead: NDArray[np.float64]) -> Release:
        """How far it may go without touching anybody; for a robot that is getting out of the way."""
        return release(ahead, self._speed_m_s, [track._replace(goes_first=False) for track in self.tracks], MARGINS)

    def in_the_way_of(self, here: NDArray[np.float64], within_s: float) -> list[str]:
        """Who of those who go first is to pass these positions (N, 2) within that time."""
        found = []
        for mate, track in zip(self.mates, self.tracks, strict=True):
            soon = track._replace(positions=track.positions[: 1 + round(within_s * track.speed_m_s / STEP_M)])
            if track.goes_first and meet(here, soon, MARGINS.contest_m):
                found.append(mate.name)
        return found

    def still_meets(self, ahead: NDArray[np.float64], names: Sequence[str]) -> bool:
        """Whether the way of any of these mates meets that of the robot, whoever goes first."""
        return any(
            meet(ahead, track, MARGINS.contest_m)
            for mate, track in zip(self.mates, self.tracks, strict=True)
            if mate.name in names
        )

    def to_escape(self, *, push: bool = False) -> tuple[float, list[Track], float]:
        """What the planner has to know to find a refuge: own speed, tracks, distance between hulls.

        With `push`, mates that go after the robot do not count: they make room in their turn.
        """
        tracks = [
            track
            for mate, track in zip(self.mates, self.tracks, strict=True)
            if not push or track.goes_first or mate.doing is Doing.OBSTACLE
        ]
        return self._speed_m_s, tracks, REFUGE_M


def circles(mates: Sequence[Mate], margin_m: float, doing: Doing) -> list[Circle]:
    """Where mates of one kind are, with a margin beyond their radius."""
    return [(mate.pose.x_m, mate.pose.y_m, mate.radius_m + margin_m) for mate in mates if mate.doing is doing]


def zones(mates: Sequence[Mate], encounter: Encounter, margin_m: float) -> list[Zone]:
    """Floor to leave to others: the ways of those who go first, and the places of those who wait."""
    found = []
    for mate, track in zip(mates, encounter.tracks, strict=True):
        ahead = round(ZONE_AHEAD_M / STEP_M) if track.goes_first else 1
        found.append(Zone(track.positions[:ahead], mate.radius_m + margin_m))
    return found
