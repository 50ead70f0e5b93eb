"""Driving by hand under a deadman's lease: the wheels turn only while the lease's holder keeps commanding.

A holder takes the lease, and each velocity that it asks for renews it. A holder that vanishes, hangs or loses its link
renews nothing: the lease lapses and the robot stops. A lapsed lease is never renewed, so late commands of a stalled
process or link move nothing. The holder must take a new lease.
"""

import math

from robrain.protocol.answers.hand_control import HandLease
from robrain.protocol.clock import to_ns
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.keys import is_name
from robrain.protocol.model.geometry import Twist2D

LONGEST_LEASE_S = 2.0
RENEWALS = 4
"""Renewals in the time of a lease, so that the holder may be late with one."""


class ByHand:
    """Lease for driving by hand: its holder, velocity and end.

    Args:
        lease_s: how long the wheels turn after the last command.

    Raises:
        ValueError: the lease is not within 0 and LONGEST_LEASE_S.

    """

    def __init__(self, lease_s: float) -> None:
        if not 0 < lease_s <= LONGEST_LEASE_S:
            raise ValueError(f"expected 0 < hand_lease_s <= {LONGEST_LEASE_S:g}, got {lease_s:g}")
        self.wanted = Twist2D()
        """Velocity in the body frame."""
        self._lease_ns, self._lease_s = to_ns(lease_s), lease_s
        self._number = 0
        self._holder = ""
        self._lapses_ns = 0
        self._until_ns: int | None = None
        self._commanded_ns: int | None = None

    def holder(self, now_ns: int) -> str:
        """Present holder of the lease; empty if there is none."""
        return self._holder if now_ns < self._lapses_ns else ""

    def lease(self, by: str, now_ns: int) -> HandLease:
        """Give the lease to a holder. The same holder's earlier lease ends with it.

        Raises:
            CallError: another holder has it (`busy`), or the name is invalid (`bad_arguments`).

        """
        if not is_name(by):
            raise CallError(ErrorCode.BAD_ARGUMENTS, f"acquire_hand_lease: {by!r} cannot be a holder's name")
        holder = self.holder(now_ns)
        if holder not in ("", by):
            raise CallError(ErrorCode.BUSY, f"{holder} drives the robot by hand")
        self._number += 1
        self._holder, self._lapses_ns = by, now_ns + self._lease_ns
        return HandLease(lease=self._number, lease_s=self._lease_s, renew_s=self._lease_s / RENEWALS)

    def ask(self, wanted: Twist2D, lease: int, now_ns: int) -> None:
        """Want this velocity, and renew the lease; standing still gives robot and lease back at once.

        Raises:
            CallError: a number is not finite (`bad_arguments`), or the lease is not held (`refused`).

        """
        numbers = (wanted.forward_m_s, wanted.left_m_s, wanted.yaw_rad_s)
        if not all(map(math.isfinite, numbers)):
            raise CallError(ErrorCode.BAD_ARGUMENTS, f"move: expected finite numbers, got {numbers}")
        is_held = lease == self._number and self.holder(now_ns) != ""
        if not any(numbers):  # a stop is allowed at any time; another holder's drive continues
            if is_held:
                self._lapses_ns = now_ns
                self._until_ns = None if self._until_ns is None else now_ns
            return
        if not is_held:
            reason = "it has lapsed, or somebody else holds it; take it again with acquire_hand_lease"
            raise CallError(ErrorCode.REFUSED, f"move: lease {lease} is not held: {reason}")
        self.wanted = wanted
        self._lapses_ns = self._until_ns = now_ns + self._lease_ns

    def holds(self, now_ns: int) -> bool:
        """Whether a holder drives now."""
        return self._until_ns is not None and now_ns < self._until_ns

    def is_command_due(self, now_ns: int, period_ns: int) -> bool:
        """Whether the last command is a period old, within half a check; if so, the next one is made now."""
        last_ns = self._commanded_ns
        if last_ns is not None and 0 <= now_ns - last_ns < period_ns - period_ns // 6:
            return False
        self._commanded_ns = now_ns
        return True

    def has_ended(self, now_ns: int) -> bool:
        """Whether driving by hand has ended; True once."""
        if self._until_ns is None or self.holds(now_ns):
            return False
        self.stop()
        return True

    def stop(self) -> None:
        """Forget the command."""
        self._until_ns = self._commanded_ns = None
        self.wanted = Twist2D()

    def let_go(self) -> None:
        """End the lease as well: the next driver has to take it again."""
        self.stop()
        self._lapses_ns = 0
