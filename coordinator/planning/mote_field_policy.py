"""Actions of the coordinator for the motes on its own initiative."""

from typing import Annotated

from msgspec import Meta

from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import NotNegative, NotNegativeInt, Positive


class MoteFieldPolicy(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Actions of the coordinator on its own initiative that keep a field of motes alive; by default none.

    Raises ValueError if a value is invalid.
    """

    watch: bool = False
    """Whether to report the state of the field even if no action is taken for it."""
    collect_age_s: NotNegative = 0.0
    """Age of a mote's newest reading at which a robot is to collect; 0: never."""
    collect_timeout_s: Positive = 20.0
    """Longest wait at a mote; at least three of its periods."""
    stand_ins: NotNegativeInt = 0
    """Number of robots that may stand in for motes at the same time."""
    stand_in_s: Positive = 120.0
    """Duration of such a task."""
    replace_before_s: NotNegative = 60.0
    """Time before a mote's predicted end at which a robot may stand in for it."""
    relays: NotNegativeInt = 0
    """Number of robots that may be relays for cut-off motes at the same time."""
    relay_s: Positive = 120.0
    """Duration of such a task."""
    relay_reach_m: Positive = 6.0
    """Distance up to which a relay is expected to receive motes."""
    turns_s: NotNegative = 0.0
    """Period in which motes are put on duty and off duty; 0: all are always on duty."""
    rest_factor: Annotated[float, Meta(ge=1)] = 10.0
    """Off duty, a mote measures once in this number of its periods, but at least every 0.4 `collect_age_s`."""
    sensing_m: Positive = 5.0
    """Distance up to which a mote's reading represents the floor, for duties and coverage."""

    @property
    def is_on(self) -> bool:
        """Whether there is anything to do or to report."""
        return bool(self.watch or self.collect_age_s or self.stand_ins or self.relays or self.turns_s)
