"""The default: by tours as long as few robots explore, else jointly.

One or two robots have to see everything themselves, so the order of all frontiers matters. A larger team has robots
enough to be sent to what matters now, and much of what lies behind falls to others.
"""

from robrain.protocol.exploration.joint import joint
from robrain.protocol.exploration.situation import Choice, Situation
from robrain.protocol.exploration.tours import tours

TOUR_ROBOTS = 2
"""Largest number of robots that are sent on tours. With ideal motion and 8 seeds, two robots know 95 % of a depot after
50.7 s by tours and 55.3 s jointly, four after 34.7 and 32.9 s."""


def auto(situation: Situation) -> list[Choice]:
    """Choose by `tours` for a team of one or two, by `joint` for a larger one."""
    robots = len(situation.seekers) + len(situation.busy)
    return tours(situation) if robots <= TOUR_ROBOTS else joint(situation)
