"""Figures of the accuracy of maps and of robots' poses.

`map_accuracy.py` and `pose_accuracy.py` compute them from the ground truth, which only a simulation has.
"""

import msgspec

from robrain.protocol.model.ranges import Count, Length, Quantity, Seconds, Share

RECENT_SCANS = 10
"""Number of scans over which the agreement with the map is averaged."""


class MapAccuracy(msgspec.Struct, frozen=True, kw_only=True):
    """Accuracy of a map: its occupied cells compared with the true walls."""

    occupied_cells: Count
    """Occupied cells of the map."""
    cells_off: Count
    """Occupied cells with no true wall near them (`map_accuracy.OFF_M`)."""
    share_off: Share
    """`cells_off` over `occupied_cells`; 0 for a map without occupied cells."""
    doubled_walls_m: Length
    """Length of walls that are on the map twice, in metres: at the right place and beside it."""


class PoseAccuracy(msgspec.Struct, frozen=True, kw_only=True):
    """Accuracy of a robot's poses: estimates compared with true poses, over the run up to now.

    Errors and NEES include only samples in which the robot does not report that it is lost. NEES is the normalised
    estimation error squared (Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to Tracking and Navigation*,
    section 5.4.2). Its mean is the number of dimensions if the covariance is right.
    """

    samples: Count = 0
    """Number of samples in which the robot was not lost."""
    rmse_m: Length | None = None
    """Root mean square of the distance from the true position; None without samples."""
    max_error_m: Length | None = None
    """Largest error of position."""
    yaw_rmse_rad: Length | None = None
    """Root mean square error of heading."""
    nees: Quantity | None = None
    """Mean NEES of x and y, 2 dimensions; None without a covariance."""
    nees_with_yaw: Quantity | None = None
    """Mean NEES of x, y and yaw, 3 dimensions."""
    nees_in_band: Share | None = None
    """Share of samples whose NEES of x and y is at most its 95 % bound, 5.99."""
    lost_s: Seconds = 0.0
    """Time during which the robot reported that it was lost."""
    silent_divergence_s: Seconds = 0.0
    """Time during which its error exceeded `pose_accuracy.FAR_OFF_M` and it did not report so."""
    longest_silent_divergence_s: Seconds = 0.0
    """Duration of the longest silent divergence."""
    error_m: Length | None = None
    """Position error of the last sample, lost or not; None before the first."""
    silent_for_s: Seconds = 0.0
    """Duration of the silent divergence at the last sample; 0 if there is none."""
    is_lost: bool = False
    """Whether it reports at the last sample that it is lost."""


def recent_agreement(before: float | None, share: float) -> float:
    """Agreement with the map after another scan, as an exponential mean.

    Args:
        before: the agreement up to now, 0 to 1; None before the first scan.
        share: share of this scan's beams that end at walls of the map, 0 to 1.

    """
    return share if before is None else before + (share - before) / RECENT_SCANS
