"""Driving by hand under a deadman's lease: a velocity holds only for as long as somebody goes on asking for it."""

import math

from robrain.protocol.model.geometry import Twist2D
from robrain.protocol.wire.clock import to_ns

LONGEST_LEASE_S = 2.0


class ByHand:
    """What is asked for, and until when."""

    def __init__(self) -> None:
        self.wanted = Twist2D()
        """Velocity in the body frame."""
        self._until_ns: int | None = None

    @property
    def has_driven(self) -> bool:
        """Whether somebody drives by hand, or did and `has_ended` has not reported the end yet."""
        return self._until_ns is not None

    def ask(self, wanted: Twist2D, lease_s: float, now_ns: int) -> None:
        """Want this velocity for so long; standing still gives the robot back at once.

        Raises:
            ValueError: a number is not finite, or the lease is not within 0 and LONGEST_LEASE_S.

        """
        numbers = (wanted.forward_m_s, wanted.left_m_s, wanted.yaw_rad_s, lease_s)
        if not all(map(math.isfinite, numbers)):
            raise ValueError(f"expected finite numbers, got {numbers}")
        if not 0 < lease_s <= LONGEST_LEASE_S:
            raise ValueError(f"expected 0 < lease_s <= {LONGEST_LEASE_S:g}, got {lease_s:g}")
        self.wanted = wanted
        self._until_ns = now_ns + to_ns(lease_s) if any(numbers[:3]) else now_ns

    def holds(self, now_ns: int) -> bool:
        """Whether somebody drives now."""
        return self._until_ns is not None and now_ns < self._until_ns

    def has_ended(self, now_ns: int) -> bool:
        """Whether somebody drove, and does not any more; said once."""
        if self._until_ns is None or now_ns < self._until_ns:
            return False
        self.let_go()
        return True

    def let_go(self) -> None:
        """Forget what was asked for."""
        self._until_ns = None
        self.wanted = Twist2D()
