"""Tabs and panels of a page, and their resources: the browser's page, all pages' shared state, and queries."""

import contextlib
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, Self

import viser

from robrain.dashboard.layers.layer import LayerSwitch
from robrain.dashboard.layers.scene import Scene
from robrain.dashboard.replay.replay_source import ReplaySource
from robrain.dashboard.server.asker import Asker, QueryOutcome, Then
from robrain.dashboard.server.hand_pilot import HandPilot, driver_of
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.answers.hand_control import HandControl
from robrain.protocol.messages.robots.plugin_messages import PluginInfo
from robrain.protocol.messages.tasks.plan_messages import PlanningStatus
from robrain.protocol.messages.tasks.task_messages import KnownKind
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import STOCK_KINDS
from robrain.protocol.schema.struct_schema import parameters_schema
from robrain.protocol.table.topic import Topic
from robrain.protocol.table.topics import COORDINATOR_PLANNING, ROBOT_PLUGINS, TASK_KINDS
from robrain.protocol.wire.endpoint import Endpoint

if TYPE_CHECKING:  # loads the comparison of recordings
    from robrain.dashboard.panels.what_if import ForkRunner

BY = "operator:dashboard"
"""Name of the page in halts and in records of tasks."""
PLUGINS_S = 2.0
PLANNING_S = 5.0


@dataclass
class PluginsOf:
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
        self._plugins: dict[str, PluginsOf] = {}
        self.planning: PlanningStatus | None = None
        self.kinds: list[KnownKind] = stock_kinds()
        """Kinds of tasks that the coordinator last reported; robrain's own until then."""
        self._planning_s: float | None = None

    def step(self, selected: Collection[str], now_s: float) -> None:
        """Send due queries."""
        for robot in selected:
            known = self._plugins.setdefault(robot, PluginsOf())
            if not known.waiting and (known.asked_s is None or now_s - known.asked_s >= PLUGINS_S):
                known.asked_s, known.waiting = now_s, True
                self._asker.ask(ROBOT_PLUGINS, None, self._taker(robot), timeout_s=2.0, robot=robot)
        for robot in [robot for robot in self._plugins if robot not in selected]:
            del self._plugins[robot]
        if self._view.coordinator_up and (self._planning_s is None or now_s - self._planning_s >= PLANNING_S):
            self._planning_s = now_s
            self._asker.ask(COORDINATOR_PLANNING, None, self._handle_planning)
            self._asker.ask(TASK_KINDS, None, self._handle_kinds)

    def plugins_of(self, robot: str) -> PluginsOf:
        """The known plugins of a robot."""
        return self._plugins.get(robot, PluginsOf())

    def ask_again(self, robot: str) -> None:
        """Ask a robot for its plugins at the next step, as they have changed."""
        self.plugins_of(robot).asked_s = None

    def _taker(self, robot: str) -> Then[list[PluginInfo]]:
        def show(answer: QueryOutcome[list[PluginInfo]]) -> None:
            known = self.plugins_of(robot)
            known.waiting = False
            try:
                known.plugins, known.problem = answer.reply, ""
            except ValueError as error:
                known.problem = str(error)

        return show

    def _handle_kinds(self, answer: QueryOutcome[list[KnownKind]]) -> None:
        with contextlib.suppress(ValueError):  # asked again soon; until then the last known kinds are offered
            self.kinds = answer.reply or self.kinds

    def _handle_planning(self, answer: QueryOutcome[PlanningStatus]) -> None:
        self.planning = None if answer.error else answer.known  # an error: the coordinator does not plan
        if self.planning is not None:
            places = self.planning.chargers
            self._view.chargers = tuple(place for place in places if abs(place.x_m) < 1e6 and abs(place.y_m) < 1e6)


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


class Page(Protocol):
    """One browser's page, as its tabs use it."""

    client: viser.ClientHandle
    context: PageContext
    selected: str
    """Name of the selected robot; empty if none."""
    follows: bool
    """Whether the camera follows the selected robot."""
    switches: list[LayerSwitch]
    """Which layers this browser shows."""

    def post(self, action: Callable[[], None]) -> None:
        """Run an action in the dashboard's next step; may be called from any thread."""

    def select(self, robot: str) -> None:
        """Select a robot, if there is one of that name."""

    def tell(self, title: str, body: str = "", *, error: str = "", color: Any = "green") -> None:
        """Show a notification in the corner: the body, or in red the error."""

    def set_dark(self, dark: bool) -> None:
        """Switch between the dark and the light theme."""

    def set_follow(self, follows: bool) -> None:
        """Whether the camera follows the selected robot."""

    def show_overview(self) -> None:
        """Move the camera to where the whole map is seen from the side and above."""

    def show_top(self) -> None:
        """Move the camera above the map."""


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

    def __init__(self, page: Page) -> None:
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
