"""The client side of driving by hand: acquires the driver's lease when it is needed, renews it, and releases it."""

import contextlib
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from robrain.protocol.errors import CallError, ErrorCode, RobrainError
from robrain.protocol.model.ranges import Count, PositiveDuration

DRIVER = "driver"
RENEW_S = 0.025
"""Period of renewals, if the robot's driver has the default lease."""
LONGEST_RENEW_S = 0.5
"""A robot is asked again after this, whatever its answer."""


class HandLease(msgspec.Struct, frozen=True, kw_only=True):
    """The right to drive a robot by hand, until it lapses."""

    lease: Count
    """Number of the lease; each `move` gives it."""
    lease_s: PositiveDuration
    """It lapses this long after it was taken or renewed."""
    renew_s: PositiveDuration
    """Period in which to call `move`."""


CallDriver = Callable[[str, Mapping[str, object]], Any]
"""Calls a function of a robot's driver, arguments by name; returns decoded JSON, raises RobrainError."""


class HandControl:
    """Drives one robot by hand. Call `move` every `renew_s` while a person, or a program, wants it to move.

    Args:
        call: reaches the robot's driver.
        by: name of the holder; no other drives the robot meanwhile.

    """

    def __init__(self, call: CallDriver, by: str) -> None:
        self.renew_s = RENEW_S
        """Period of `move`; the robot sends it with the first one."""
        self._call = call
        self._by = by
        self._lease: int | None = None

    def move(self, forward_m_s: float = 0.0, left_m_s: float = 0.0, yaw_rad_s: float = 0.0) -> None:
        """Want this velocity, body frame, until the lease lapses; zero gives the robot back.

        A lease that has lapsed on a slow link is acquired again, and the next call moves the robot. A request from
        before the wait no longer counts.

        Raises:
            CallError: another client drives the robot (`busy`), or it does not obey.
            NobodyThere: the robot is absent.

        """
        velocity = {"forward_m_s": forward_m_s, "left_m_s": left_m_s, "yaw_rad_s": yaw_rad_s}
        if not any(velocity.values()):
            self.release()
            return
        lease = self._lease if self._lease is not None else self._handle()
        try:
            self._call("move", velocity | {"lease": lease})
        except RobrainError as error:
            self._lease = None  # a driver that was restarted counts its leases from the start
            if not (isinstance(error, CallError) and error.code is ErrorCode.REFUSED):
                raise
            self._handle()

    def _handle(self) -> int:
        answer = self._call("acquire_hand_lease", {"by": self._by})
        try:
            acquired = msgspec.convert(answer, HandLease)
        except msgspec.ValidationError as error:
            raise CallError(ErrorCode.FAILED, f"acquire_hand_lease: the answer is no lease: {error}") from error
        self._lease, self.renew_s = acquired.lease, min(acquired.renew_s, LONGEST_RENEW_S)
        return acquired.lease

    def release(self) -> None:
        """Release the robot; if it does not receive this, the lease lapses."""
        if self._lease is None:
            return
        lease, self._lease = self._lease, None
        with contextlib.suppress(RobrainError):
            self._call("move", {"forward_m_s": 0.0, "left_m_s": 0.0, "yaw_rad_s": 0.0, "lease": lease})
