"""The motes of the team, by their readings: place, quantity and receivers."""

from robrain.coordinator.team.roster import Roster
from robrain.protocol.border.reading_sieve import measured_at_ns
from robrain.protocol.clock import to_seconds
from robrain.protocol.messages.motes.mote_messages import MoteReading
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.reasons import RobotReason, plain

MOTES_MAX = 4096
PERIODS = 3.0
"""A mote that has been silent for this number of its periods, and for `SILENT_S`, is out of reach (chosen)."""
SILENT_S = 5.0
USUAL_PERIOD_S = 4.0
"""Of a mote that does not report how often it senses."""


class KnownMote:
    """One mote."""

    def __init__(self, reading: MoteReading, now_ns: int) -> None:
        self.name = reading.mote
        self.latest = reading
        self.heard_ns = now_ns

    @property
    def place(self) -> Point2D | None:
        """Where it is, arena frame."""
        return self.latest.place

    @property
    def period_s(self) -> float:
        """How often it senses and speaks."""
        return self.latest.period_s or USUAL_PERIOD_S

    @property
    def measured_ns(self) -> int:
        """When its last reading was sensed."""
        return measured_at_ns(self.latest)

    def note(self, reading: MoteReading, now_ns: int) -> None:
        """A message arrived; a stored reading does not show its present state."""
        if measured_at_ns(reading) >= self.measured_ns:
            self.latest, self.heard_ns = reading, now_ns

    def silent_s(self, now_ns: int) -> float:
        """Since when nothing new of it has come."""
        return to_seconds(now_ns - self.heard_ns)

    def out_of_reach_reason(self, roster: Roster, now_ns: int) -> RobotReason | None:
        """Why its messages cannot be relied on; None if they can."""
        silent_s = self.silent_s(now_ns)
        if silent_s > max(SILENT_S, PERIODS * self.period_s):
            return plain("mote_silent", f"was last heard {silent_s:.0f} s ago", silent_s=round(silent_s, 3))
        via = roster.robots.get(self.latest.via)
        # A carrier that is no robot is a gateway: its readings are its sign of life.
        out = via.down_reason(now_ns) if via is not None else None
        if via is None or out is None:
            return None
        text = f"{via.name}, which heard it, is not there: {out}"
        return plain("carrier_out", text, robot=via.name, because=out.code)


class MoteTable:
    """All known motes, up to a maximum number."""

    def __init__(self) -> None:
        self.motes: dict[str, KnownMote] = {}
        self.refused = 0
        """Readings of motes that were one too many."""

    def quantities(self) -> dict[str, str]:
        """Last measured quantity of each mote, by its name."""
        return {name: mote.latest.quantity for name, mote in self.motes.items()}

    def note(self, reading: MoteReading, now_ns: int) -> None:
        """A robot or gateway has delivered a reading."""
        mote = self.motes.get(reading.mote)
        if mote is not None:
            mote.note(reading, now_ns)
        elif len(self.motes) < MOTES_MAX:
            self.motes[reading.mote] = KnownMote(reading, now_ns)
        else:
            self.refused += 1

    def near(self, place: Point2D, most: int) -> list[KnownMote]:
        """The motes nearest to a place, nearest first; those that do not know where they are are not among them."""
        placed = [(_distance_m(mote.place, place), mote.name) for mote in self.motes.values() if mote.place is not None]
        return [self.motes[name] for _, name in sorted(placed)[:most]]


def _distance_m(one: Point2D | None, other: Point2D) -> float:
    assert one is not None
    return float(((one.x_m - other.x_m) ** 2 + (one.y_m - other.y_m) ** 2) ** 0.5)
