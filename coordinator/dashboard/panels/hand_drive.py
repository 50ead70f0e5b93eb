"""Driving a robot by hand: while a button or key is held, the dashboard renews a short lease on the driver.

`driver.move` drives for `LEASE_S` at most. If the browser closes, hangs or loses its link, the lease is not renewed,
and the robot stops.
"""

from collections.abc import Callable
from typing import NamedTuple

import msgspec
import viser

from robrain.coordinator.dashboard.html.html_words import text
from robrain.coordinator.dashboard.panels.gui_values import set_html, set_value
from robrain.coordinator.dashboard.panels.page_context import Page
from robrain.coordinator.dashboard.server.asker import Answer
from robrain.protocol.wire.topics import ROBOT_CALL

LEASE_S = 0.5
HELD_S = 0.3
"""A button counts as released when its last hold event is older than this."""
HOLD_HZ = 10.0
REPEAT_S = 0.15


class Push(NamedTuple):
    """A velocity in the body frame, as shares of the chosen speed: forward, left, counter-clockwise."""

    forward: float = 0.0
    left: float = 0.0
    turn: float = 0.0


PUSHES: tuple[tuple[str, Push], ...] = (
    ("Forward (W)", Push(forward=1.0)),
    ("Back (S)", Push(forward=-1.0)),
    ("Turn left (A)", Push(turn=1.0)),
    ("Turn right (D)", Push(turn=-1.0)),
    ("Left (Q)", Push(left=1.0)),
    ("Right (E)", Push(left=-1.0)),
)
TURN_PER_SPEED = 2.5
"""Turning rate, rad/s, for each m/s of the chosen speed."""


class HandDrive:
    """The controls of one page; built within a folder's context."""

    def __init__(self, page: Page) -> None:
        gui = page.client.gui
        self._page = page
        self._armed = gui.add_checkbox("Armed", False, hint="While armed, W A S D Q E drive the selected robot")
        self._armed.on_update(lambda _: page.post(self._arm))
        self._speed = gui.add_slider("Speed (m/s)", 0.05, 0.6, 0.05, 0.25)
        self._status = gui.add_html("")
        self._held: dict[Push, float] = {}
        self._now_s = 0.0
        self._sent_s: float | None = None
        self._moving = ""
        self._waits = False
        self._buttons = []
        for label, push in PUSHES:
            button = gui.add_button(label, disabled=True)
            self._buttons.append(button)
            button.on_hold(self._holder(push), HOLD_HZ)
        self._arm()

    def let_go(self) -> None:
        """Disarm, and let the lease run out."""
        self._held.clear()
        if self._armed.value:
            set_value(self._armed, False)
            self._arm()

    def step(self, now_s: float) -> None:
        """Send the velocity of the held buttons, and once a stop when they are released."""
        self._now_s = now_s
        self._held = {push: at_s for push, at_s in self._held.items() if now_s - at_s <= HELD_S}
        if not self._held and not self._moving:
            return
        if self._waits or (self._sent_s is not None and now_s - self._sent_s < REPEAT_S):
            return
        robot = self._moving or self._page.selected
        pushes = list(self._held) if robot == self._page.selected else []
        self._moving = robot if pushes else ""
        self._sent_s = now_s
        self._send(robot, pushes)

    def _send(self, robot: str, pushes: list[Push]) -> None:
        speed_m_s = self._speed.value
        velocity = {
            "forward_m_s": speed_m_s * sum(push.forward for push in pushes),
            "left_m_s": speed_m_s * sum(push.left for push in pushes),
            "yaw_rad_s": TURN_PER_SPEED * speed_m_s * sum(push.turn for push in pushes),
            "lease_s": LEASE_S,
        }
        self._waits = True

        def take(answer: Answer[bytes]) -> None:
            self._waits = False
            if answer.error:
                self._moving = ""
                self._held.clear()
                self._show(f'<span class="rb-bad">✕ {text(robot)}: {text(answer.error)}</span>')
            else:
                self._show(f"▶ {text(robot)} is driving" if pushes else f"■ {text(robot)} stopped")

        names = {"robot": robot, "plugin": "driver", "function": "move"}
        self._page.context.asker.ask(ROBOT_CALL, msgspec.json.encode(velocity), take, timeout_s=1.0, **names)

    def _arm(self) -> None:
        armed = bool(self._armed.value)
        for button in self._buttons:
            button.disabled = not armed
        self._show("Armed: hold a button or a key." if armed else "Not armed.")

    def _show(self, html: str) -> None:
        mark = " rb-teleop-armed" if self._armed.value else ""
        set_html(self._status, f'<div class="rb{mark}" data-testid="teleop">{html}</div>')

    def _holder(self, push: Push) -> Callable[[viser.GuiEvent[viser.GuiButtonHandle]], None]:
        return lambda _: self._page.post(lambda: self._held.update({push: self._now_s}))
