"""One browser's page: its tabs, its selection, its camera. Several browsers look on at once, each with its own.

Clicks are served on viser's threads and only leave a note here; the dashboard's step does what they ask for.
"""

from collections import deque
from collections.abc import Callable
from typing import Any

import viser

from robrain.coordinator.dashboard.html.panel_html import strip_html
from robrain.coordinator.dashboard.layers.layer_switches import switches_of, troubles_of
from robrain.coordinator.dashboard.panels.gui_values import set_html
from robrain.coordinator.dashboard.panels.page_context import PageContext
from robrain.coordinator.dashboard.panels.robot_tab import RobotTab
from robrain.coordinator.dashboard.panels.task_tab import TaskTab
from robrain.coordinator.dashboard.panels.team_tab import TeamTab
from robrain.coordinator.dashboard.panels.view_tab import ViewTab
from robrain.coordinator.dashboard.scene.picking import floor_hit, mote_near, robot_near
from robrain.coordinator.dashboard.scene.selection import SelectionMark
from robrain.coordinator.dashboard.server.retry import Retry
from robrain.coordinator.dashboard.state.focus import Focus
from robrain.coordinator.dashboard.state.team_view import TeamView

NOTES = 256
PERIOD_S = 0.4
MANY_ROBOTS = 25
MANY_PERIOD_S = 1.0
Action = Callable[[], None]


class ClientPage:
    """The page of one client; all but `post` is called by the dashboard's step."""

    def __init__(self, client: viser.ClientHandle, context: PageContext) -> None:
        self.client = client
        self.context = context
        self.selected = ""
        """Name of the robot that is selected; nobody if empty."""
        self.chosen = False
        """Whether a person selected it."""
        self.mote = ""
        """Name of the selected mote; empty if none."""
        self.follows = False
        """Whether the camera goes along with the selected robot."""
        self.dark = True
        self.switches = switches_of(client, context.scene.layers)
        """Which layers of the picture it shows."""
        self.retry = Retry()
        """Schedules the next update after an error."""
        self._notes: deque[Action] = deque(maxlen=NOTES)
        self._drawn_s: float | None = None
        self._view: TeamView | None = None
        gui = client.gui
        gui.main_panel.dock_right()
        self._strip = gui.add_html("")
        gui.add_html('<div class="rb-channel"></div>')
        self._channel = gui.add_text("rows", "")
        self._channel.on_update(self._hear_row)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Team", viser.Icon.USERS):
            self.team = TeamTab(self)
        with tabs.add_tab("Robot", viser.Icon.ROBOT):
            self.robot = RobotTab(self)
        with tabs.add_tab("Tasks", viser.Icon.LIST_CHECK):
            self.tasks = TaskTab(self)
        with tabs.add_tab("View", viser.Icon.EYE):
            self.looks = ViewTab(self)
        self._mark = SelectionMark(client)
        context.scene.show_overview(client)

    def post(self, action: Action) -> None:
        """Have something done in the dashboard's next step; may be called from any thread."""
        self._notes.append(action)

    def step(self, now_s: float) -> None:
        """Do what was clicked, and bring the page up to date."""
        while self._notes:
            self._notes.popleft()()
        view = self.context.view
        if view is not self._view:
            self._view, self._drawn_s = view, None
            self.team.hurry()
            self.robot.hurry()
        if not self.selected and view.robots:
            self.select(next(iter(view.robots)), by_person=False)
        robot = view.robots.get(self.selected)
        self._mark.show(robot, follows=self.follows)
        self.context.scene.keep_framed(self.client)
        middle, reach_m = self.context.scene.looked_at(self.client)
        focus = Focus(self.selected, self.chosen, self.mote, middle, reach_m)
        for switch in self.switches:
            switch.draw(view, focus, now_s)
        self.robot.drive.step(now_s)
        period_s = MANY_PERIOD_S if len(view.robots) > MANY_ROBOTS else PERIOD_S
        if self._drawn_s is not None and now_s - self._drawn_s < period_s:
            return
        self._drawn_s = now_s
        set_html(self._strip, strip_html(view, now_s, troubles_of(self.switches, now_s)))
        self.team.draw(now_s)
        self.robot.draw(now_s)
        self.tasks.draw(now_s)
        self.looks.draw(now_s)

    def close(self) -> None:
        """The browser has gone."""
        self.robot.drive.let_go()
        self.context.scene.forget(self.client.client_id)

    # -- what is clicked ------------------------------------------------------------------------------------

    def select(self, robot: str, *, by_person: bool = True) -> None:
        """Select a robot, if there is one of that name."""
        if robot in self.context.view.robots:
            self.selected, self.chosen = robot, by_person
            self.robot.select(robot)
            self._drawn_s = None

    def select_next(self, step: int) -> None:
        """Select the robot that comes so many places later."""
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
        if self.tasks.wants_place:
            self.tasks.place(place)
            return
        found = robot_near(self.context.view, place, distance_m)
        if found is not None:
            self.select(found.name)
            return
        mote = mote_near(self.context.view, place, distance_m)
        self.select_mote(mote.name if mote is not None else "")

    def select_mote(self, mote: str) -> None:
        """Show a mote's reading and link; deselect if the name is empty or already selected."""
        self.mote = mote if mote in self.context.view.motes and mote != self.mote else ""

    def tell(self, title: str, body: str = "", *, color: Any = "green") -> None:
        """A notice in the corner; its text is shown as text."""
        self.client.add_notification(title[:80], body[:300], color=color, auto_close_seconds=6.0)

    def set_dark(self, dark: bool) -> None:
        """Dark or light."""
        self.dark = dark
        self.client.gui.configure_theme(dark_mode=dark, show_logo=False, show_share_button=False, control_width="large")

    def _hear_row(self, event: viser.GuiEvent[viser.GuiTextHandle]) -> None:
        said = event.target.value
        self.post(lambda: self._do_row(said))

    def _do_row(self, said: str) -> None:
        _, _, rest = said.partition(" ")
        verb, _, subject = rest.partition(" ")
        if verb == "select":
            self.select(subject)
        elif verb == "mote":
            self.select_mote(subject)
        elif verb == "plugin":
            self.robot.select_plugin(subject)
        elif verb == "why":
            self.tasks.ask_why(subject)
        elif verb == "resume" and self.context.halt is not None:
            self.context.halt.ask_to_resume(self.client)
        elif verb == "cancel":
            self.tasks.cancel(subject)
        elif verb == "seek" and self.context.replay is not None and subject.replace(".", "", 1).isdecimal():
            self.context.replay.seek(float(subject))
