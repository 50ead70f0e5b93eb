"""How right a map and a robot's position are, as told to people and programs: figures only, no arithmetic of arrays.

`map_accuracy.py` and `pose_accuracy.py` compute them; both need the truth, which only a simulation has.
"""

import msgspec

from robrain.protocol.model.ranges import Count, Length, Quantity, Seconds, Share

RECENT_SCANS = 10
"""So many scans count for an agreement with the map: five seconds of them at two a second."""


class MapAccuracy(msgspec.Struct, frozen=True, kw_only=True):
    """A map's occupied cells against the true walls."""

    occupied_cells: Count
    cells_off: Count
    """Occupied cells with no true wall near them (`map_accuracy.OFF_M`)."""
    share_off: Share
    """`cells_off` over `occupied_cells`; 0 for a map without occupied cells."""
    doubled_walls_m: Length
    """Length of walls that are on the map twice: where they are, and again beside it."""


class PoseAccuracy(msgspec.Struct, frozen=True, kw_only=True):
    """A robot's believed positions against the true ones, over a run so far.

    Errors and NEES are of the samples in which the robot does not say that it is lost. NEES is the normalised
    estimation error squared (Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to Tracking and Navigation*,
    section 5.4.2): its mean is the number of dimensions if the covariance is right.
    """

    samples: Count = 0
    """Those in which the robot was not lost."""
    rmse_m: Length | None = None
    """Root mean square of the distance from the true position; None without samples."""
    max_error_m: Length | None = None
    yaw_rmse_rad: Length | None = None
    nees: Quantity | None = None
    """Mean of x and y, 2 dimensions; None if no covariance was told."""
    nees_with_yaw: Quantity | None = None
    """Mean of x, y and yaw, 3 dimensions."""
    nees_in_band: Share | None = None
    """Share of samples whose NEES of x and y is at most its 95 % bound, 5.99."""
    lost_s: Seconds = 0.0
    """How long the robot said that it was lost."""
    silent_divergence_s: Seconds = 0.0
    """How long it was far off (`pose_accuracy.FAR_OFF_M`) and did not say so."""
    longest_silent_divergence_s: Seconds = 0.0
    """The longest such stretch."""
    error_m: Length | None = None
    """At the last sample, lost or not; None before the first."""
    silent_for_s: Seconds = 0.0
    """How long the stretch has lasted that the robot is in at the last sample; 0 if it is in none."""
    is_lost: bool = False
    """Whether it says so at the last sample."""


def recent_agreement(before: float | None, share: float) -> float:
    """Agreement with the map after another scan, as an exponential mean.

    Args:
        before: the agreement so far, 0 to 1; None before the first scan.
        share: share of this scan's beams that end at walls of the map, 0 to 1.

    """
    return share if before is None else before + (share - before) / RECENT_SCANS
