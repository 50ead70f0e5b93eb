"""What a page's tabs work with: the browser's page, what all pages share, and what is asked periodically."""

import contextlib
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Any, Protocol

import viser

from robrain.dashboard.layers.layer_switches import LayerSwitch
from robrain.dashboard.layers.scene import Scene
from robrain.dashboard.panels.halt_control import HaltControl
from robrain.dashboard.panels.replay_bar import ReplayBar
from robrain.dashboard.server.asker import Asker, QueryOutcome, Then
from robrain.dashboard.server.hand_pilot import HandPilot, driver_of
from robrain.dashboard.state.team_view import TeamView
from robrain.protocol.answers.hand_control import HandControl
from robrain.protocol.messages.robots.plugin_messages import PluginInfo
from robrain.protocol.messages.tasks.plan_messages import PlanningStatus
from robrain.protocol.messages.tasks.task_messages import KnownKind
from robrain.protocol.model.tasks.stock_kinds import STOCK_KINDS
from robrain.protocol.schema.struct_schema import parameters_schema
from robrain.protocol.table.topics import COORDINATOR_PLANNING, ROBOT_PLUGINS, TASK_KINDS
from robrain.protocol.wire.endpoint import Endpoint

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

    def __init__(self, view: TeamView, asker: Asker) -> None:
        self._view = view
        self._asker = asker
        self._plugins: dict[str, PluginsOf] = {}
        self.planning: PlanningStatus | None = None
        self.kinds: list[KnownKind] = stock_kinds()
        """Kinds of tasks that the coordinator last reported; robrain's own until then."""
        self._planning_s: float | None = None

    def step(self, selected: Collection[str], now_s: float) -> None:
        """Ask what is due."""
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
        """What is known of a robot's plugins."""
        return self._plugins.get(robot, PluginsOf())

    def ask_again(self, robot: str) -> None:
        """Ask a robot for its plugins at the next step, as they have changed."""
        self.plugins_of(robot).asked_s = None

    def _taker(self, robot: str) -> Then[list[PluginInfo]]:
        def take(answer: QueryOutcome[list[PluginInfo]]) -> None:
            known = self.plugins_of(robot)
            known.waiting = False
            try:
                known.plugins, known.problem = answer.reply, ""
            except ValueError as error:
                known.problem = str(error)

        return take

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
    """What the pages of all browsers share."""

    view: TeamView
    scene: Scene
    asker: Asker
    inquiries: Inquiries
    replay: ReplayBar | None
    """None for a live team."""
    halt: HaltControl | None
    """None for a recording."""
    team: Endpoint | None
    """The team's; None for a recording."""

    def pilot(self, robot: str, browser: int) -> HandPilot | None:
        """What drives a robot by hand for one browser, started; None for a recording."""
        if self.team is None:
            return None
        by = f"dashboard-{str(self.team.session.zid())[:8]}-{browser}"
        pilot = HandPilot(HandControl(driver_of(self.team, robot), by), robot)
        pilot.start()
        return pilot

    @property
    def is_live(self) -> bool:
        """Whether there is a team, not a recording."""
        return self.halt is not None


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
