"""The default: by rooms where those are small, else by tours as long as few robots explore, and jointly if more do.

Up to four robots have to see everything themselves, so the order of all frontiers matters. A larger team has robots
enough to be sent to what matters now, and much of what lies behind falls to others. Three robots and more in a building
of small rooms stand in each other's way, and leave parts of rooms behind: there `rooms` is faster.
"""

from robrain.algorithms.exploration.joint import joint
from robrain.algorithms.exploration.situation import Choice, Situation
from robrain.algorithms.exploration.tours import rooms, tours

TOUR_ROBOTS = 4
"""Largest number of robots that are sent on tours. With the full stack, four robots know 95 % of five floors after
42.2 s on average by tours and 44.6 s jointly; eight know three after 43.9 and 44.4 s (decision 0046)."""
ROOM_ROBOTS = 3
"""Least number of robots that are sent by rooms: one and two are slower so (decisions 0047, 0058 and 0063)."""
SMALL_ROOMS_M2 = 45.0
"""Area of the room around a place, mean over the known floor, below which rooms are small. While a floor is explored,
it is up to 40 m² in a clinic, up to 48 in a hospital section, 45 to 69 in a laboratory, 40 to 74 in an office, 44 to 99
in a hospital; above 75 in the end in a cave, above 190 in a depot (decision 0058)."""

KNOWN_M2 = 150.0
"""Known floor below which more than four robots are not sent by rooms: at first every building seems to have small ones
(chosen: decision 0063)."""


def auto(situation: Situation) -> list[Choice]:
    """Choose by `rooms` for three robots and more where rooms are small, else by `tours`, or by `joint` for many."""
    robots = len(situation.seekers) + len(situation.busy)
    floor = situation.floor
    is_many = robots > TOUR_ROBOTS
    is_told = floor is not None and (not is_many or floor.known_m2 > KNOWN_M2)
    if robots >= ROOM_ROBOTS and floor is not None and is_told and floor.room_m2 < SMALL_ROOMS_M2:
        return rooms(situation)
    return joint(situation) if is_many else tours(situation)
