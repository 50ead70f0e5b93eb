"""Renews the lease of a robot that a browser drives by hand, on a separate thread.

A page is drawn ten times a second at best, and a lease lapses after 0.1 s. The thread exists only while a page has
driving armed.
"""

import threading
import time
from collections.abc import Mapping
from typing import Any

import msgspec
import zenoh

from robrain.protocol.answers.hand_control import DRIVER, CallDriver, HandControl
from robrain.protocol.codec import BAD_PAYLOAD
from robrain.protocol.errors import RobrainError
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL
from robrain.protocol.model.geometry import Twist2D
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.workers import OwnedThread

HELD_S = 0.1
"""A button counts as released when its last hold event is older than this: a browser that hangs sends none."""
CALL_TIMEOUT_S = 0.3


def driver_of(endpoint: Endpoint, robot: str) -> CallDriver:
    """Calls functions of a robot's driver."""

    def call(function: str, arguments: Mapping[str, object]) -> Any:
        payload = msgspec.json.encode(arguments)
        names = {"robot": robot, "plugin": DRIVER, "function": function}
        try:
            return msgspec.json.decode(endpoint.ask(ROBOT_CALL, payload, timeout_s=CALL_TIMEOUT_S, **names))
        except (*BAD_PAYLOAD, zenoh.ZError) as error:
            raise RobrainError(f"{robot}: driver {function}: {error}") from error

    return call


class HandPilot:
    """Drives one robot for one page, while its buttons are held. Buttons may be pressed on any thread.

    Args:
        control: drives the robot.
        robot: its name, for reports.

    """

    def __init__(self, control: HandControl, robot: str) -> None:
        self.robot = robot
        self.status = ""
        """State of the drive, in words; empty before the first key."""
        self.has_failed = False
        self._control = control
        self._lock = threading.Lock()
        self._held: dict[str, tuple[float, Twist2D]] = {}
        self._moves = False
        self._pressed, self._ended = threading.Event(), threading.Event()

    def start(self) -> None:
        """Follow the buttons from now on."""
        OwnedThread(f"hand-{self.robot}", self._run)  # `end` ends it

    def press(self, button: str, velocity: Twist2D, now_s: float) -> None:
        """A button is held; called repeatedly while it is.

        Args:
            button: which one.
            velocity: requested velocity, body frame.
            now_s: seconds of the monotonic clock.

        """
        with self._lock:
            if not self._ended.is_set():
                self._held[button] = now_s, velocity
        self._pressed.set()

    def end(self) -> None:
        """Release the robot; waits for no answer."""
        with self._lock:
            self._ended.set()
            self._held.clear()
        self._pressed.set()

    def step(self, now_s: float) -> bool:
        """Renew the lease for the buttons that are held, or return it; whether to continue in a moment."""
        with self._lock:
            self._held = {name: each for name, each in self._held.items() if now_s - each[0] <= HELD_S}
            held = [velocity for _, velocity in self._held.values()]
        wanted = Twist2D(
            sum(each.forward_m_s for each in held),
            sum(each.left_m_s for each in held),
            sum(each.yaw_rad_s for each in held),
        )
        moves = wanted != Twist2D()
        if not moves and not self._moves:
            return False
        try:
            self._control.move(wanted.forward_m_s, wanted.left_m_s, wanted.yaw_rad_s)
        except RobrainError as error:
            self._moves, self.has_failed, self.status = False, True, str(error)
            with self._lock:
                self._held.clear()
            return False
        self._moves, self.has_failed = moves, False
        self.status = "is driving" if moves else "stopped"
        return moves

    def _run(self) -> None:
        while not self._ended.is_set():
            if self.step(time.monotonic()):
                self._ended.wait(self._control.renew_s)
            else:
                self._pressed.wait()
                self._pressed.clear()
        self.step(time.monotonic())  # no key is held any more: the robot is released
