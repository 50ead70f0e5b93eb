"""One browser's page: its tabs, its selection, its camera. Each browser has its own.

viser serves clicks on its own threads; they only queue an action, which the dashboard's next step runs.
"""

from collections import deque
from collections.abc import Callable
from typing import Any

import viser

from robrain.dashboard.html.team_html import (
    strip_html,
)
from robrain.dashboard.layers.layer import FIRST_RETRY_S, LONGEST_RETRY_S, switches_of, troubles_of
from robrain.dashboard.layers.robot_layers import SelectionMark, floor_hit, mote_near, robot_near
from robrain.dashboard.panels.gui_values import set_html
from robrain.dashboard.panels.page_context import PageContext, Tab
from robrain.dashboard.state.focus import Focus
from robrain.dashboard.state.parts import parts_of
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.backoff import Backoff

ACTIONS = 256
PERIOD_S = 0.4
MANY_ROBOTS = 25
MANY_PERIOD_S = 1.0


class ClientPage:
    """The page of one client; the dashboard's step calls all methods but `post`."""

    def __init__(self, client: viser.ClientHandle, context: PageContext) -> None:
        self.client = client
        self.context = context
        self.selected = ""
        """Name of the selected robot; empty if none."""
        self._chosen = False
        """Whether a person selected it."""
        self._mote = ""
        """Name of the selected mote; empty if none."""
        self.follows = False
        """Whether the camera follows the selected robot."""
        self.dark = True
        self.switches = switches_of(client, context.scene.layers)
        """Which layers this browser shows."""
        self.retry = Backoff(FIRST_RETRY_S, LONGEST_RETRY_S)
        """Schedules the next update after an error."""
        self._actions: deque[Callable[[], None]] = deque(maxlen=ACTIONS)
        self._drawn_s: float | None = None
        self._view: ShownTeam | None = None
        gui = client.gui
        gui.main_panel.dock_right()
        self._strip = gui.add_html("")
        gui.add_html('<div class="rb-channel"></div>')
        channel = gui.add_text("rows", "")
        channel.on_update(self._handle_row_click)
        group = gui.add_tab_group()
        self._tabs: list[Tab] = []
        for tab in parts_of(Tab):
            with group.add_tab(tab.title, tab.icon):
                self._tabs.append(tab(self))
        self._row_actions: dict[str, Callable[[str], None]] = {"select": self.select, "mote": self.select_mote}
        for part in self._tabs:
            self._row_actions |= part.row_actions()
        for panel in context.panels:
            self._row_actions |= panel.row_actions(client)
        self._mark = SelectionMark(client)
        context.scene.show_overview(client)

    def post(self, action: Callable[[], None]) -> None:
        """Run an action in the dashboard's next step; may be called from any thread."""
        self._actions.append(action)

    def step(self, now_s: float) -> None:
        """Run the queued actions, and show the current state."""
        while self._actions:
            self._actions.popleft()()
        view, scene = self.context.view, self.context.scene
        if view is not self._view:
            self._view, self._drawn_s = view, None
            for tab in self._tabs:
                tab.hurry()
        if self.selected not in view.robots and view.robots:
            self.select(next(iter(view.robots)), by_person=False)
        self._mark.show(view.robots.get(self.selected), follows=self.follows)
        scene.keep_framed(self.client)
        middle, reach_m = scene.camera_target(self.client)
        focus = Focus(self.selected, self._chosen, self._mote, middle, reach_m)
        for switch in self.switches:
            switch.draw(view, focus, now_s)
        for tab in self._tabs:
            tab.step()
        period_s = MANY_PERIOD_S if len(view.robots) > MANY_ROBOTS else PERIOD_S
        if self._drawn_s is not None and now_s - self._drawn_s < period_s:
            return
        self._drawn_s = now_s
        set_html(self._strip, strip_html(view, now_s, troubles_of(self.switches, now_s)))
        for tab in self._tabs:
            tab.draw(now_s)

    def close(self) -> None:
        """Release resources of a browser that has disconnected."""
        self.release()
        self.context.scene.forget(self.client.client_id)

    def release(self) -> None:
        """Release resources of this browser, such as a robot that it drives."""
        for tab in self._tabs:
            tab.close()

    def select(self, robot: str, *, by_person: bool = True) -> None:
        """Select a robot, if there is one of that name."""
        if robot in self.context.view.robots:
            self.selected, self._chosen = robot, by_person
            for tab in self._tabs:
                tab.handle_selection()
            self._drawn_s = None

    def select_next(self, step: int) -> None:
        """Select the robot that is `step` places later in the list, or earlier if negative."""
        names = list(self.context.view.robots)
        if names:
            at = names.index(self.selected) if self.selected in names else -step
            self.select(names[(at + step) % len(names)])

    def click_floor(self, origin: tuple[float, float, float], direction: tuple[float, float, float]) -> None:
        """Handle a click along a ray: place a task if one is being added, else select the robot or mote there."""
        hit = floor_hit(origin, direction)
        if hit is None:
            return
        place, distance_m = hit
        if any(tab.accept_place(place) for tab in self._tabs):
            return
        if (robot := robot_near(self.context.view, place, distance_m)) is not None:
            self.select(robot.name)
        else:
            mote = mote_near(self.context.view, place, distance_m)
            self.select_mote(mote.name if mote is not None else "")

    def select_mote(self, mote: str) -> None:
        """Show a mote's reading and link; deselect if the name is empty or already selected."""
        self._mote = mote if mote in self.context.view.motes and mote != self._mote else ""

    def tell(self, title: str, body: str = "", *, error: str = "", color: Any = "green") -> None:
        """Show a notification in the corner: the body, or in red the error."""
        color = "red" if error else color
        self.client.add_notification(title[:80], (error or body)[:300], color=color, auto_close_seconds=6.0)

    def show_overview(self) -> None:
        """Move the camera to where the whole map is seen from the side and above."""
        self.set_follow(False)
        self.context.scene.show_overview(self.client)

    def show_top(self) -> None:
        """Move the camera above the map."""
        self.set_follow(False)
        self.context.scene.show_top(self.client)

    def set_follow(self, follows: bool) -> None:
        """Whether the camera follows the selected robot."""
        self.follows = follows
        self._drawn_s = None

    def set_dark(self, dark: bool) -> None:
        """Switch between the dark and the light theme."""
        self.dark = dark
        set_theme(self.client.gui, dark=dark)

    def _handle_row_click(self, event: viser.GuiEvent[viser.GuiTextHandle]) -> None:
        row = event.target.value
        self.post(lambda: self._do_row_click(row))

    def _do_row_click(self, row: str) -> None:
        """Act on a click that `page.js` reports: a counter, a verb and its subject."""
        verb, _, subject = row.partition(" ")[2].partition(" ")
        if verb in self._row_actions:
            self._row_actions[verb](subject)


def set_theme(gui: viser.GuiApi, *, dark: bool) -> None:
    """Set the page's theme, without viser's own logo and share button."""
    gui.configure_theme(dark_mode=dark, show_logo=False, show_share_button=False, control_width="large")
