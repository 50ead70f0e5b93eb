"""What the coordinator does for the motes by itself."""

import math

import msgspec

from robrain.protocol.model.ranges import check_not_negative, check_positive


class MoteFieldPolicy(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the coordinator does by itself to keep a field of motes alive; by default nothing.

    Raises ValueError if a value is invalid.
    """

    watch: bool = False
    """Whether to tell how the field is doing even if nothing is done for it."""
    collect_age_s: float = 0.0
    """Age of a mote's newest reading at which a robot is to collect; 0: never."""
    collect_timeout_s: float = 20.0
    """Longest wait at a mote; at least three of its periods."""
    stand_ins: int = 0
    """Number of robots that may stand in for motes at the same time."""
    stand_in_s: float = 120.0
    """Duration of such a task."""
    replace_before_s: float = 60.0
    """Time before a mote's predicted end at which a robot may stand in for it."""
    relays: int = 0
    """Number of robots that may be relays for cut-off motes at the same time."""
    relay_s: float = 120.0
    """Duration of such a task."""
    relay_reach_m: float = 6.0
    """Distance up to which a relay is expected to hear motes."""
    turns_s: float = 0.0
    """Period in which motes are put on duty and off duty; 0: all are always on duty."""
    rest_factor: float = 10.0
    """Off duty, a mote takes a reading in so many of its periods, but at least every 0.4 `collect_age_s`."""
    sensing_m: float = 5.0
    """Distance up to which a mote's reading tells of the floor, for duties and coverage."""

    def __post_init__(self) -> None:
        check_not_negative(self, "collect_age_s", "replace_before_s", "turns_s", finite=True)
        check_positive(self, "collect_timeout_s", "stand_in_s", "relay_s", "relay_reach_m", "sensing_m", below=math.inf)
        check_not_negative(self, "stand_ins", "relays")
        if not (math.isfinite(self.rest_factor) and self.rest_factor >= 1):
            raise ValueError(f"expected rest_factor >= 1, got {self.rest_factor}")

    @property
    def is_on(self) -> bool:
        """Whether there is anything to do or to tell."""
        return bool(self.watch or self.collect_age_s or self.stand_ins or self.relays or self.turns_s)
