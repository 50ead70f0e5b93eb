"""What an inertial measurement unit offers."""

from typing import Protocol

import msgspec


class ImuSample(msgspec.Struct, frozen=True):
    """One measurement, robot's frame (x ahead, y to the left, z up)."""

    stamp_ns: int
    """Time of measurement, robot's clock."""
    yaw_rate_rad_s: float
    """Turn rate about z, to the left positive, with its bias."""
    forward_m_s2: float | None = None
    """Acceleration along x, as measured; None if it is not."""
    left_m_s2: float | None = None
    """Along y."""


class ImuInterface(Protocol):
    """Measurements as they come; each is left on the board, where the odometry finds it."""

    def latest(self) -> ImuSample | None:
        """The last measurement; None before the first."""
