"""One browser's page: its tabs, its selection, its camera; and the resources of tabs and panels.

viser serves clicks on its own threads; they only queue an action, which the dashboard's next step runs.
"""

from collections import deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Self

import viser

from robrain.client.asker import Asker
from robrain.dashboard.html.team_html import strip_html
from robrain.dashboard.layers.layer import FIRST_RETRY_S, LONGEST_RETRY_S, layer_alerts, switches_of
from robrain.dashboard.layers.robot_layers import SelectionMark, floor_hit, mote_near, robot_near
from robrain.dashboard.layers.scene import Scene
from robrain.dashboard.panels.gui_values import set_html
from robrain.dashboard.replay.replay_source import ReplaySource
from robrain.dashboard.server.hand_pilot import HandPilot, driver_of
from robrain.dashboard.state.focus import Focus
from robrain.dashboard.state.parts import parts_of
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.answers.hand_control import HandControl
from robrain.protocol.backoff import Backoff
from robrain.protocol.messages.robots.plugin_messages import ROBOT_PLUGINS, PluginInfo
from robrain.protocol.messages.tasks.plan_messages import COORDINATOR_PLANNING, PlanningStatus
from robrain.protocol.messages.tasks.task_messages import TASK_KINDS, KnownKind
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import STOCK_KINDS
from robrain.protocol.schema.struct_schema import parameters_schema
from robrain.protocol.topic import Topic
from robrain.protocol.wire.endpoint import Endpoint

if TYPE_CHECKING:  # loads the comparison of recordings
    from robrain.dashboard.panels.what_if import ForkRunner

BY = "operator:dashboard"
"""Name of the page in halts and in records of tasks."""
PLUGINS_S = 2.0
PLANNING_S = 5.0


@dataclass
class RobotPlugins:
    """A robot's plugins as it last reported them."""

    plugins: list[PluginInfo] = field(default_factory=list)
    problem: str = ""
    asked_s: float | None = None
    waiting: bool = False


def stock_kinds() -> list[KnownKind]:
    """The kinds of tasks that robrain's own behaviors do."""
    return [KnownKind(kind=kind, parameters=parameters_schema(type_)) for kind, type_ in STOCK_KINDS.items()]


class Inquiries:
    """Asks the selected robots for their plugins, and the coordinator for its planning, chargers and kinds of tasks."""

    def __init__(self, view: ShownTeam, asker: Asker) -> None:
        self._view = view
        self._asker = asker
        self._plugins: dict[str, RobotPlugins] = {}
        self.planning: PlanningStatus | None = None
        self.kinds: list[KnownKind] = stock_kinds()
        """Kinds of tasks that the coordinator last reported; robrain's own until then."""
        self._planning_s: float | None = None

    def step(self, selected: Collection[str], now_s: float) -> None:
        """Send due queries."""
        for robot in selected:
            known = self._plugins.setdefault(robot, RobotPlugins())
            if not known.waiting and (known.asked_s is None or now_s - known.asked_s >= PLUGINS_S):
                known.asked_s, known.waiting = now_s, True
                then = partial(self._handle_plugins, robot)
                self._asker.ask(ROBOT_PLUGINS, None, then, timeout_s=2.0, robot=robot)
        for robot in [robot for robot in self._plugins if robot not in selected]:
            del self._plugins[robot]
        if self._view.coordinator_up and (self._planning_s is None or now_s - self._planning_s >= PLANNING_S):
            self._planning_s = now_s
            self._asker.ask(COORDINATOR_PLANNING, None, self._handle_planning)
            self._asker.ask(TASK_KINDS, None, self._handle_kinds)

    def plugins_of(self, robot: str) -> RobotPlugins:
        """The known plugins of a robot."""
        return self._plugins.get(robot, RobotPlugins())

    def ask_again(self, robot: str) -> None:
        """Ask a robot for its plugins at the next step, as they have changed."""
        self.plugins_of(robot).asked_s = None

    def _handle_plugins(self, robot: str, plugins: list[PluginInfo] | None, error: str) -> None:
        known = self.plugins_of(robot)
        known.waiting, known.problem = False, error
        if plugins is not None:
            known.plugins = plugins

    def _handle_kinds(self, kinds: list[KnownKind] | None, error: str) -> None:
        self.kinds = kinds or self.kinds  # asked again soon; until then the last known kinds are offered

    def _handle_planning(self, planning: PlanningStatus | None, error: str) -> None:
        self.planning = planning  # None: the coordinator does not plan
        if planning is not None:
            self._view.chargers = tuple(planning.chargers)


@dataclass
class PageContext:
    """State that the pages of all browsers share."""

    view: ShownTeam
    scene: Scene
    asker: Asker
    inquiries: Inquiries
    panels: "list[Panel]"
    """Floating panels, which all browsers share."""
    team: Endpoint | None
    """The team's; None for a recording."""

    def pilot(self, robot: str, browser: int) -> HandPilot | None:
        """A started pilot that drives a robot by hand for one browser; None for a recording."""
        if self.team is None:
            return None
        by = f"dashboard-{str(self.team.session.zid())[:8]}-{browser}"
        pilot = HandPilot(HandControl(driver_of(self.team, robot), by), robot)
        pilot.start()
        return pilot

    @property
    def is_live(self) -> bool:
        """Whether there is a team, not a recording."""
        return self.team is not None


RowActions = Mapping[str, Callable[[str], None]]
"""By verb: action of a click on an element with `data-rb="VERB SUBJECT"`, called with the subject."""
NO_ACTIONS: RowActions = MappingProxyType({})


class Tab:
    """A tab of one browser's page; made within the tab's context."""

    title: ClassVar[str]
    icon: ClassVar[Any] = None
    """One of `viser.Icon`."""
    topics: ClassVar[tuple[Topic[Any], ...]] = ()
    """Read from `ShownTeam.others`."""

    def __init__(self, page: "Page") -> None:
        raise NotImplementedError

    def draw(self, now_s: float) -> None:
        """Show the current state."""
        raise NotImplementedError

    def step(self) -> None:
        """Do work that must not wait for the next `draw`; called about ten times a second."""

    def hurry(self) -> None:
        """Update everything at the next `draw`, even if that is before it is due."""

    def handle_selection(self) -> None:
        """Another robot is selected."""

    def accept_place(self, place: Point2D) -> bool:
        """Whether the tab wants a click on the floor; others then do not get it."""
        return False

    def row_actions(self) -> RowActions:
        """Actions of the tab's own elements."""
        return NO_ACTIONS

    def close(self) -> None:
        """Release resources of the browser: it has disconnected, or its page cannot be updated."""


@dataclass
class PanelContext:
    """The inputs of panels."""

    server: viser.ViserServer
    team: Endpoint | None
    """None for a recording."""
    recording: ReplaySource | None
    """None for a live team."""
    forks: "ForkRunner | None"
    """Runs a recording otherwise; None if that is not offered."""


class Panel:
    """A floating panel, which all browsers share."""

    topics: ClassVar[tuple[Topic[Any], ...]] = ()
    """Read from `ShownTeam.others`."""

    @classmethod
    def make(cls, context: PanelContext) -> Self | None:
        """The panel; None if it is not for this page."""
        raise NotImplementedError

    def draw(self, view: ShownTeam, now_s: float) -> None:
        """Show the current state."""
        raise NotImplementedError

    def row_actions(self, client: viser.ClientHandle) -> RowActions:
        """Actions of elements in one browser."""
        return NO_ACTIONS

    def close(self) -> None:
        """Stop running queries and processes."""


ACTIONS = 256
PERIOD_S = 0.4
MANY_ROBOTS = 25
MANY_PERIOD_S = 1.0


class Page:
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
        set_html(self._strip, strip_html(view, now_s, layer_alerts(self.switches, now_s)))
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

    def notify(self, title: str, body: str = "", *, error: str = "", color: Any = "green") -> None:
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
