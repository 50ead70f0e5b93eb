"""Driving a robot by hand: while a button or key is held, the dashboard renews a short lease on the driver.

If the browser hangs, its hold events cease; if the dashboard or its link fails, the lease is not renewed. Either way
the robot stands within 0.3 s (see `server/hand_pilot.py`).
"""

import time
from collections.abc import Callable
from typing import NamedTuple

import viser

from robrain.coordinator.dashboard.html.html_words import text
from robrain.coordinator.dashboard.panels.gui_values import set_html, set_value
from robrain.coordinator.dashboard.panels.page_context import Page
from robrain.coordinator.dashboard.server.hand_pilot import HandPilot, Velocity

HOLD_HZ = 40.0


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
        self._speed = gui.add_slider(
            "Speed (m/s)", 0.05, 0.6, 0.05, 0.25, hint="The robot's hand_speed_m_s is the limit"
        )
        self._status = gui.add_html("")
        self._pilot: HandPilot | None = None
        self._shown = ""
        self._buttons = []
        for label, push in PUSHES:
            button = gui.add_button(label, disabled=True)
            self._buttons.append(button)
            button.on_hold(self._holder(label, push), HOLD_HZ)
        self._arm()

    def let_go(self) -> None:
        """Disarm, and give the robot back."""
        if self._armed.value or self._pilot is not None:
            set_value(self._armed, False)
            self._arm()

    def step(self) -> None:
        """Show how the drive goes; it goes on without this."""
        pilot = self._pilot
        if pilot is None or not pilot.told or pilot.told == self._shown:
            return
        self._shown = told = pilot.told
        robot = text(pilot.robot)
        if pilot.has_failed:
            self._show(f'<span class="rb-bad">✕ {robot}: {text(told)}</span>')
        else:
            self._show(f"{'■' if told == 'stopped' else '▶'} {robot} {told}")

    def _arm(self) -> None:
        page, armed = self._page, bool(self._armed.value)
        for button in self._buttons:
            button.disabled = not armed
        if self._pilot is not None:
            self._pilot.end()
            self._pilot = None
        if armed and page.selected:
            self._pilot, self._shown = page.context.pilot(page.selected, page.client.client_id), ""
        self._show("Armed: hold a button or a key." if armed else "Not armed.")

    def _show(self, html: str) -> None:
        mark = " rb-teleop-armed" if self._armed.value else ""
        set_html(self._status, f'<div class="rb{mark}" data-testid="teleop">{html}</div>')

    def _holder(self, label: str, push: Push) -> Callable[[viser.GuiEvent[viser.GuiButtonHandle]], None]:
        def hold(_: object) -> None:  # on viser's thread: the page's own step may take longer than a lease
            pilot, speed_m_s = self._pilot, float(self._speed.value)
            if pilot is not None:
                velocity = Velocity(
                    speed_m_s * push.forward, speed_m_s * push.left, TURN_PER_SPEED * speed_m_s * push.turn
                )
                pilot.press(label, velocity, time.monotonic())

        return hold
