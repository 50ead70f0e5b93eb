"""The default: by tours as long as few robots explore, else jointly.

Up to four robots have to see everything themselves, so the order of all frontiers matters. A larger team has robots
enough to be sent to what matters now, and much of what lies behind falls to others.
"""

from robrain.protocol.exploration.joint import joint
from robrain.protocol.exploration.situation import Choice, Situation
from robrain.protocol.exploration.tours import tours

TOUR_ROBOTS = 4
"""Largest number of robots that are sent on tours. With the full stack, four robots know 95 % of five floors after
42.2 s on average by tours and 44.6 s jointly; eight know three after 43.9 and 44.4 s (decision 0046)."""


def auto(situation: Situation) -> list[Choice]:
    """Choose by `tours` for a team of up to four, by `joint` for a larger one."""
    robots = len(situation.seekers) + len(situation.busy)
    return tours(situation) if robots <= TOUR_ROBOTS else joint(situation)
