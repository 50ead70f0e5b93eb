"""How bytes of an inertial measurement unit become measurements."""

from typing import NamedTuple, Protocol


class ImuMotion(NamedTuple):
    """One measurement in the axes of the unit: x ahead, y to the left, z up if it is mounted like that."""

    yaw_rate_rad_s: float
    """About z."""
    x_m_s2: float | None = None
    y_m_s2: float | None = None


class ImuCodec(Protocol):
    """Finds the measurements in a stream of bytes; it keeps what is incomplete, of bounded length."""

    rejected: int
    """Frames or lines with a wrong checksum, or that cannot be read."""
    stray_bytes: int
    """Bytes outside of any frame or line."""

    def feed(self, data: bytes) -> list[ImuMotion]:
        """The measurements that these bytes complete."""
