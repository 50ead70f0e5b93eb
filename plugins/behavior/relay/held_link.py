"""One link that a relay holds: how strong it is by the last packets, and whether it is silent."""

from robrain.protocol.model.geometry import Point2D

NEW_SHARE = 0.3
"""How much a packet's strength counts against those before: fading must not move the robot."""
SILENT_DBM = -1000.0
"""Counts as the strength of a link on which nothing is heard."""


class HeldLink:
    """The link to one mote or robot.

    Args:
        begun_ns: what was heard before does not count.
        silent_ns: who has not been heard for so long has no link.

    """

    def __init__(self, begun_ns: int, silent_ns: int) -> None:
        self.place: Point2D | None = None
        """Where the other end is, arena frame; None while that is not known."""
        self.strengths_dbm: list[float] = []
        self._begun_ns = begun_ns
        self._silent_ns = silent_ns
        self._stamp_ns = 0
        self._rssi_dbm: float | None = None

    def hear(self, rssi_dbm: float, stamp_ns: int) -> None:
        """The last packet heard, once more or a new one."""
        if stamp_ns <= max(self._stamp_ns, self._begun_ns):
            return
        self._stamp_ns = stamp_ns
        old_dbm = rssi_dbm if self._rssi_dbm is None else self._rssi_dbm
        self._rssi_dbm = old_dbm + NEW_SHARE * (rssi_dbm - old_dbm)
        self.strengths_dbm.append(rssi_dbm)

    def strength_dbm(self, now_ns: int) -> float:
        """How strong it is; SILENT_DBM if nothing was heard for too long, or since the robot has moved."""
        if self._rssi_dbm is None or now_ns - max(self._stamp_ns, self._begun_ns) > self._silent_ns:
            return SILENT_DBM
        return self._rssi_dbm

    def move(self) -> None:
        """The robot has moved: what it heard before tells nothing of its new place."""
        self._rssi_dbm = None

    @property
    def mean_dbm(self) -> float | None:
        """Mean of all packets heard, to a tenth; None if there was none."""
        return round(sum(self.strengths_dbm) / len(self.strengths_dbm), 1) if self.strengths_dbm else None
