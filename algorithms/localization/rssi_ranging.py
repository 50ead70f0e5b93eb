"""Distance to a mote by the strength of its signal: log-distance path loss with shadowing.

Mean: Rappaport, *Wireless Communications, Principles and Practice*, 2nd ed., section 4.9. Shadowing that changes with
the driven path: M. Gudmundson, *Correlation model for shadow fading in mobile radio systems*, Electronics Letters 1991.
"""

import math

import msgspec

from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import NotNegative, Positive

NEAREST_M = 0.1
"""A mote seems never nearer than this: the far field ends, and so does the model."""


class RssiSample(msgspec.Struct, frozen=True):
    """One packet of a mote whose place is known, arena frame."""

    mote: str
    place: Point2D
    rssi_dbm: float
    stamp_ns: int = 0


class PathLoss(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Received power over distance. All values are chosen for a Mica2 at −20 dBm indoors; calibrate them at the place.

    Indoors the decorrelation distance is some metres (3GPP TR 38.901, table 7.5-6: 6 to 10 m in offices). Raises
    ValueError where it is built with a value that is not above 0 (deviations: not below).
    """

    rssi_at_1_m_dbm: float = -60.0
    exponent: Positive = 3.0
    shadowing_db: NotNegative = 4.0
    """Standard deviation of the effect of walls and furniture on one mote's signal: it stays until the robot has moved.
    """
    decorrelation_m: Positive = 5.0
    """Path length after which the shadowing's correlation is 1/e."""
    fading_db: Positive = 4.0
    """Standard deviation from packet to packet, including the error of the model."""

    @property
    def db_per_e_fold(self) -> float:
        """Loss for each factor of e in distance: 10·exponent / ln 10."""
        return 10.0 * self.exponent / math.log(10.0)

    def mean_dbm(self, distance_m: float) -> float:
        """Expected strength at a distance.

        >>> PathLoss().mean_dbm(10.0)
        -90.0
        """
        return self.rssi_at_1_m_dbm - self.db_per_e_fold * math.log(max(distance_m, NEAREST_M))

    def range_m(self, rssi_dbm: float) -> float:
        """The distance at which this strength is expected.

        >>> PathLoss().range_m(-90.0)
        10.0
        """
        return float(10.0 ** ((self.rssi_at_1_m_dbm - rssi_dbm) / (10.0 * self.exponent)))
