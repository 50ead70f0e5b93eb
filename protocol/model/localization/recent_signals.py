"""The last signals of motes, and where on its way the robot heard them."""

import math
from collections import deque

import numpy as np

from robrain.protocol.model.geometry import Pose2D, Twist2D
from robrain.protocol.model.localization.mote_relocalisation import Signals
from robrain.protocol.model.localization.odometry import moved_along
from robrain.protocol.model.localization.rssi_ranging import PathLoss, RssiSample
from robrain.protocol.model.numeric.kernel_array import Floats

RECORDS = 64
RECORDS_TO_FIND = 24
MOTES_TO_FIND = 4
WAY_TO_FIND_M = 2.0
"""A robot that has not moved cannot tell its yaw from signals."""


class RecentSignals:
    """Follows the way by odometry, in a frame of its own, and remembers the last `RECORDS` signals on it."""

    def __init__(self) -> None:
        self.has_heard = False
        """Whether there ever was one."""
        self._records: deque[tuple[RssiSample, Pose2D]] = deque(maxlen=RECORDS)
        self._reckoned = Pose2D(0.0, 0.0, 0.0)

    def __len__(self) -> int:
        return len(self._records)

    def move(self, displacement: Twist2D) -> None:
        """The robot has moved so, as `odometry.chord` gives it, its errors taken off."""
        self._reckoned = moved_along(self._reckoned, displacement)

    def hear(self, sample: RssiSample) -> None:
        """A mote was heard."""
        self._records.append((sample, self._reckoned))
        self.has_heard = True

    def forget(self) -> None:
        """What was heard before may have been heard elsewhere."""
        self._records.clear()

    def can_find(self, way_m: float) -> bool:
        """Whether they are enough to look for the robot, after so much way."""
        names = {sample.mote for sample, _ in self._records}
        return len(self._records) >= RECORDS_TO_FIND and len(names) >= MOTES_TO_FIND and way_m > WAY_TO_FIND_M

    def seen_from_here(self) -> Signals:
        """All of them, with the places in the frame of the robot as it is now."""
        samples = [sample for sample, _ in self._records]
        places = {sample.mote: sample.place for sample in samples}
        index = {mote: number for number, mote in enumerate(places)}
        back = self._reckoned.inverse()
        seen_from = [back.compose(at) for _, at in self._records]
        return Signals(
            np.array([(at.x_m, at.y_m) for at in seen_from]),
            np.array([index[sample.mote] for sample in samples], np.int64),
            np.array([(place.x_m, place.y_m) for place in places.values()]),
            np.array([sample.rssi_dbm for sample in samples], np.float64),
        )

    def nis(self, here: Pose2D, path_loss: PathLoss) -> float:
        """Mean normalised square of what they are off by, were the robot here; 0 if there are none."""
        if not self._records:
            return 0.0
        places, motes, mote_places, rssi_dbm = self.seen_from_here()
        cos, sin = math.cos(here.yaw_rad), math.sin(here.yaw_rad)
        x_m = here.x_m + cos * places[:, 0] - sin * places[:, 1]
        y_m = here.y_m + sin * places[:, 0] + cos * places[:, 1]
        distances_m = np.hypot(x_m - mote_places[motes, 0], y_m - mote_places[motes, 1])
        off_db: Floats = rssi_dbm - [path_loss.mean_dbm(distance_m) for distance_m in distances_m.tolist()]
        return float(np.mean(off_db**2)) / (path_loss.shadowing_db**2 + path_loss.fading_db**2)
