"""One browser's page: its tabs, its selection, its camera. Each browser has its own.

viser serves clicks on its own threads; they only queue an action, which the dashboard's next step runs.
"""

import secrets
from collections import deque
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import viser

from robrain.client.errors import BadTask
from robrain.client.submission import submission_of
from robrain.dashboard.html.charts import add_chart
from robrain.dashboard.html.elements import CLOSE_MARK, cut, render
from robrain.dashboard.html.task_html import explanation_html, gantt_html, queue_html
from robrain.dashboard.html.team_html import (
    field_html,
    left_html,
    log_html,
    motes_html,
    robots_html,
    rules_html,
    strip_html,
    summary_html,
)
from robrain.dashboard.layers.floor_layers import FieldLayer
from robrain.dashboard.layers.layer_switches import LayerSwitch, switches_of, troubles_of
from robrain.dashboard.layers.selection import SelectionMark, floor_hit, mote_near, robot_near
from robrain.dashboard.panels.form_panel import FormPanel
from robrain.dashboard.panels.function_form import FormField, fields_of
from robrain.dashboard.panels.gui_values import on_choice, set_html, set_value, set_visible
from robrain.dashboard.panels.halt_control import BY
from robrain.dashboard.panels.page_context import Page, PageContext
from robrain.dashboard.panels.robot_tab import RobotTab
from robrain.dashboard.server.asker import QueryOutcome
from robrain.dashboard.server.retry import Retry
from robrain.dashboard.state.focus import Focus
from robrain.dashboard.state.team_view import TeamView
from robrain.protocol.messages.tasks.plan_messages import ObjectiveRequest, PlanningStatus
from robrain.protocol.messages.tasks.task_messages import KnownKind, TaskRecord, TaskRequest, TaskSubmission, TaskWhy
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.model.tasks.stock_kinds import EXPLORE, VISIT
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.schema.announced_parameters import check_announced
from robrain.protocol.table.topics import COORDINATOR_OBJECTIVE, TASK_CANCEL, TASK_SUBMIT, TASK_WHY
from robrain.recording.drawing.palette import HEAT

CHART_PERIOD_S = 2.0
MANY_ROWS = 25
LIST_PERIOD_S = 2.5
"""Period of a longer table, which costs a browser more than the picture."""


HIDDEN = {"id", "kind", "parameters", "earliest_ns", "deadline_ns", "needs", "after", "robots"}
"""Fields of tasks that the form leaves to scripts, and the id, which is generated."""
GANTT_PERIOD_S = 1.0
BELOW_THE_FORM = 1e9
"""Order of the button: the form is rebuilt for each kind of task, and would otherwise come after it."""
BY_CLICK, BY_CLICK_WAITS = "Click on the map to add a task", "Now click on the map (or here to cancel)"


class TaskTab:
    """The tab of one page; built within the tab's context."""

    def __init__(self, page: Page) -> None:
        gui = page.client.gui
        self._page = page
        self.wants_place = False
        """Whether the next click on the map is a place for a new task."""
        self._drawn_s: float | None = None
        self._known_objective: Objective | None = None
        live = page.context.is_live
        self._summary = gui.add_html("")
        with gui.add_folder("Add a task", visible=live):
            self._by_click = gui.add_button(BY_CLICK, color="blue")
            self._by_click.on_click(lambda _: page.post(lambda: self._want_place(not self.wants_place)))
            self._kinds = self._known_kinds()
            self._wanted = VISIT
            """The kind that the operator chose last."""
            names = tuple(sorted(self._kinds))
            first = self._wanted if self._wanted in names else None
            self._kind = gui.add_dropdown("Kind", names, initial_value=first)
            self._kind.on_update(
                lambda event: page.post(lambda: self._choose(event.target.value, by_hand=event.client is not None))
            )
            self._status = gui.add_html("")
            slot = gui.add_folder("Coordinates and options", expand_by_default=False)
            self._form = FormPanel(gui, slot)
            with slot:
                add = gui.add_button("Add task at these coordinates", color="gray", order=BELOW_THE_FORM)
            add.on_click(lambda _: page.post(self._add))
        with gui.add_folder("Queue"):
            self._queue = gui.add_html("")
        with gui.add_folder("Plan"):
            self._objective = gui.add_dropdown("Objective", tuple(Objective), visible=live)
            on_choice(self._objective, lambda value: page.post(lambda: self._set_objective(Objective(value))))
            self._planning = gui.add_html("")
            self._gantt = gui.add_html("")
        self._choose(self._kind.value, by_hand=False)

    def draw(self, now_s: float) -> None:
        """Show the current state."""
        context = self._page.context
        view = context.view
        waiting = sum(event.robot == "" for event in view.tasks.values())
        done = view.team.tasks_done if view.team is not None else sum(e.state == "done" for e in view.board.ended)
        set_html(self._summary, render("tasks", "summary", open=len(view.tasks), waiting=waiting, done=done))
        set_html(self._queue, queue_html(view, is_live=context.is_live, done=done))
        if self._drawn_s is None or now_s - self._drawn_s >= GANTT_PERIOD_S:
            self._drawn_s = now_s
            set_html(self._gantt, gantt_html(view))
            self._draw_planning()
            self._update_kinds()

    def add_at(self, place: Point2D) -> None:
        """Add the task of the form at a place that was clicked."""
        self._want_place(False)
        self._form.set("place.x_m", f"{place.x_m:.2f}")
        self._form.set("place.y_m", f"{place.y_m:.2f}")
        self._add()

    def cancel(self, task: str) -> None:
        """Cancel a task."""

        def take(answer: QueryOutcome[TaskRecord]) -> None:
            self._page.tell(f"Cancel {task}", "done", error=answer.error)

        request = TaskRequest(id=task, by=BY, why="cancelled on the dashboard")
        self._page.context.asker.ask(TASK_CANCEL, request, take)

    def ask_why(self, task: str) -> None:
        """Show why a task stands as it does, in a window of this browser alone."""

        def take(answer: QueryOutcome[TaskWhy]) -> None:
            try:
                html = explanation_html(answer.reply)
            except ValueError as error:
                html = render("elements", "message", kind="bad", words=cut(str(error), 400))
            gui = self._page.client.gui
            modal = gui.add_modal(f"Why: {task[:40]}")
            with modal:
                gui.add_html(html)
                gui.add_html(CLOSE_MARK)
                gui.add_button("Close").on_click(lambda _: self._page.post(modal.close))

        self._page.context.asker.ask(TASK_WHY, TaskRequest(id=task, by=BY), take)

    def _want_place(self, wants: bool) -> None:
        self.wants_place = wants
        self._by_click.label = BY_CLICK_WAITS if wants else BY_CLICK
        self._by_click.color = "orange" if wants else "blue"

    def _choose(self, kind: str, *, by_hand: bool) -> None:
        if kind in self._kinds:
            if by_hand:
                self._wanted = kind
            self._form.show(task_fields(self._kinds[kind]))

    def _known_kinds(self) -> dict[str, KnownKind]:
        """Kinds that a person may ask for, by name; of a kind that robots announce differently the first."""
        return {one.kind: one for one in reversed(self._page.context.inquiries.kinds) if one.kind != EXPLORE}

    def _update_kinds(self) -> None:
        kinds = self._known_kinds()
        if kinds == self._kinds:
            return
        self._kinds = kinds
        names = tuple(sorted(kinds))
        if names != tuple(self._kind.options):
            self._kind.options = names  # viser keeps the value if it is still there
        if self._wanted in kinds:  # a kind that no robot announces for a moment is chosen again when it is back
            set_value(self._kind, self._wanted)
        self._choose(self._kind.value, by_hand=False)

    def _add(self) -> None:
        try:
            submission = form_submission(self._kinds[self._kind.value], self._form.arguments())
        except (BadTask, ValueError) as error:
            self._show("bad", f"✕ {error}")
            return
        self._show("soft", f"{submission.task.id}: sent …")

        def take(answer: QueryOutcome[TaskRecord]) -> None:
            try:
                record = answer.reply
            except ValueError as error:
                self._show("bad", f"✕ {error}")
            else:
                self._show("good", f"✓ {record.task.id} is {record.state.value}")

        self._page.context.asker.ask(TASK_SUBMIT, submission, take)

    def _show(self, kind: str, words: str) -> None:
        set_html(self._status, render("elements", "message", kind=kind, words=cut(words, 400), testid="task-told"))

    def _draw_planning(self) -> None:
        status = self._page.context.inquiries.planning
        if status is None:
            set_html(self._planning, "")
            return
        if status.objective != self._known_objective:  # else keep what somebody has just chosen
            self._known_objective = status.objective
            set_value(self._objective, status.objective)
        set_html(self._planning, render("tasks", "planning", status=status))

    def _set_objective(self, objective: Objective) -> None:
        def take(answer: QueryOutcome[PlanningStatus]) -> None:
            self._page.tell("Planning", f"objective from now on: {objective}", error=answer.error)

        request = ObjectiveRequest(objective=objective, by=BY)
        self._page.context.asker.ask(COORDINATOR_OBJECTIVE, request, take)


def task_fields(kind: KnownKind) -> list[FormField]:
    """The form's fields for a kind of task; its schema comes from a robot and is not trusted."""
    (_,), definitions = msgspec.json.schema_components([Task])
    common, own = definitions["Task"], kind.parameters
    properties, own_definitions = own.get("properties"), own.get("$defs")
    definitions = (own_definitions if isinstance(own_definitions, dict) else {}) | definitions
    given = properties if isinstance(properties, dict) else {}
    shown = {name: shape for name, shape in (given | common["properties"]).items() if name not in HIDDEN}
    needed = own.get("required")
    required = [*common["required"], *(needed if isinstance(needed, list) else [])]
    order = sorted(shown, key=lambda name: (name != "place", name not in required))
    properties = {name: shown[name] for name in order} | {"deadline_in_s": {"type": "number"}}
    return fields_of({"properties": properties, "required": required, "$defs": definitions})


def form_submission(known: KnownKind, arguments: dict[str, Any]) -> TaskSubmission:
    """A new task of the form's arguments, with a generated id.

    Raises:
        BadTask: a field is invalid.
        BadParameters: a parameter does not fit the kind's announced schema.

    """
    submission = submission_of(known.kind, {**arguments, "id": f"{known.kind}-{secrets.token_hex(3)}"})
    check_announced(known.kind, submission.task.parameters, [known.parameters])
    return msgspec.structs.replace(submission, by=BY)


class TeamTab:
    """The tab of one page; built within the tab's context."""

    def __init__(self, page: Page) -> None:
        gui = page.client.gui
        self._page = page
        self._summary = gui.add_html("")
        self._robots = gui.add_html("")
        self._folder = gui.add_folder("Explored over time", visible=False)
        with self._folder:
            self._chart = add_chart(gui, "Explored (%)", ["explored"], (0.0, 100.0))
        self._left_folder = gui.add_folder("Left to explore", visible=False)
        with self._left_folder:
            self._left = gui.add_html("")
        self._field_folder = gui.add_folder("Mote field", visible=False)
        with self._field_folder:
            self._field = gui.add_html("")
        self._rules_folder = gui.add_folder("Rules", visible=False)
        with self._rules_folder:
            self._rules = gui.add_html("")
        with gui.add_folder("Log", expand_by_default=False):
            self._log = gui.add_html("")
        self._charted_s: float | None = None
        self._listed_s: float | None = None
        self._listed: tuple[str, int] | None = None

    def hurry(self) -> None:
        """Update everything at the next `draw`, even if that is before it is due."""
        self._charted_s = self._listed_s = None

    def draw(self, now_s: float) -> None:
        """Show the current state."""
        view = self._page.context.view
        set_html(self._summary, summary_html(view, now_s))
        shown = (self._page.selected, len(view.robots))
        due = self._listed_s is None or now_s - self._listed_s >= LIST_PERIOD_S
        if due or shown != self._listed or len(view.robots) <= MANY_ROWS:
            self._listed_s, self._listed = now_s, shown
            set_html(self._robots, robots_html(view, now_s, self._page.selected))
        for folder, shown_html, html in (
            (self._left_folder, self._left, left_html(view)),
            (self._field_folder, self._field, field_html(view)),
            (self._rules_folder, self._rules, rules_html(view)),
        ):
            set_visible(folder, bool(html))
            set_html(shown_html, html)
        set_html(self._log, log_html(view))
        if len(view.explored) > 1 and (self._charted_s is None or now_s - self._charted_s >= CHART_PERIOD_S):
            self._charted_s = now_s
            self._folder.visible = True
            time_s, fraction = np.array(view.explored).T
            self._chart.data = (time_s, 100 * fraction)


OVERVIEW, TOP = "Overview", "Top view"
MOTES_PERIOD_S = 3.0


class ViewTab:
    """The tab of one page; built within the tab's context."""

    def __init__(self, page: Page) -> None:
        gui = page.client.gui
        self._page = page
        self._listed_s: float | None = None
        camera = gui.add_button_group("Camera", (OVERVIEW, TOP))
        camera.on_click(lambda event: page.post(self.top if event.target.value == TOP else self.overview))
        self._follow = gui.add_checkbox("Follow selected", False)
        self._follow.on_update(lambda event: page.post(lambda: self.set_follow(event.target.value)))
        theme = gui.add_button_group("Colours", ("Dark", "Light"))
        theme.on_click(lambda event: page.post(lambda: page.set_dark(event.target.value == "Dark")))
        with gui.add_folder("Layers"):
            for switch in page.switches:
                self._add_box(switch)
            self._scale = gui.add_html("", visible=False)
        with gui.add_folder("Legend and keys", expand_by_default=False):
            gui.add_html(render("controls", "legend"))
        self._mote_folder = gui.add_folder("Motes", expand_by_default=False, visible=False)
        with self._mote_folder:
            self._motes = gui.add_html("")

    def draw(self, now_s: float) -> None:
        """Show the current state."""
        view = self._page.context.view
        set_visible(self._mote_folder, bool(view.motes))
        if view.motes and (self._listed_s is None or now_s - self._listed_s >= MOTES_PERIOD_S):
            self._listed_s = now_s
            set_html(self._motes, motes_html(view))
        layers = [switch.layer for switch in self._page.switches if switch.shown]
        scale = next((layer.range for layer in layers if isinstance(layer, FieldLayer)), None)
        set_visible(self._scale, scale is not None)
        if scale is not None:
            set_html(self._scale, scale_html(*scale))

    def overview(self) -> None:
        """Move the camera to where the whole map is seen from the side and above."""
        self.set_follow(False)
        self._page.context.scene.show_overview(self._page.client)

    def top(self) -> None:
        """Move the camera above the map."""
        self.set_follow(False)
        self._page.context.scene.show_top(self._page.client)

    def set_follow(self, follows: bool) -> None:
        """Whether the camera follows the selected robot."""
        self._page.follows = follows
        set_value(self._follow, follows)

    def _add_box(self, switch: LayerSwitch) -> None:
        def choose(shown: bool) -> None:
            switch.shown = shown

        box = self._page.client.gui.add_checkbox(switch.label, switch.shown)
        box.on_update(lambda event: self._page.post(lambda: choose(event.target.value)))


def scale_html(quantity: str, low: float, high: float) -> str:
    """The heat map's colours, with the values at both ends."""
    return render("controls", "scale", quantity=quantity, steps=HEAT, low=low, high=high)


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
        self.retry = Retry()
        """Schedules the next update after an error."""
        self._actions: deque[Callable[[], None]] = deque(maxlen=ACTIONS)
        self._drawn_s: float | None = None
        self._view: TeamView | None = None
        gui = client.gui
        gui.main_panel.dock_right()
        self._strip = gui.add_html("")
        gui.add_html('<div class="rb-channel"></div>')
        channel = gui.add_text("rows", "")
        channel.on_update(self._handle_row_click)
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
            self.team.hurry()
            self.robot.hurry()
        if self.selected not in view.robots and view.robots:
            self.select(next(iter(view.robots)), by_person=False)
        self._mark.show(view.robots.get(self.selected), follows=self.follows)
        scene.keep_framed(self.client)
        middle, reach_m = scene.camera_target(self.client)
        focus = Focus(self.selected, self._chosen, self._mote, middle, reach_m)
        for switch in self.switches:
            switch.draw(view, focus, now_s)
        self.robot.drive.step()
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
        """Release what belongs to a browser that has disconnected."""
        self.robot.drive.let_go()
        self.context.scene.forget(self.client.client_id)

    def select(self, robot: str, *, by_person: bool = True) -> None:
        """Select a robot, if there is one of that name."""
        if robot in self.context.view.robots:
            self.selected, self._chosen = robot, by_person
            self.robot.select()
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
        if self.tasks.wants_place:
            self.tasks.add_at(place)
        elif (robot := robot_near(self.context.view, place, distance_m)) is not None:
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
        acts: dict[str, Callable[[str], None]] = {
            "select": self.select,
            "mote": self.select_mote,
            "plugin": self.robot.select_plugin,
            "why": self.tasks.ask_why,
            "cancel": self.tasks.cancel,
        }
        if verb in acts:
            acts[verb](subject)
        elif verb == "resume" and self.context.halt is not None:
            self.context.halt.ask_to_resume(self.client)
        elif verb == "seek" and self.context.replay is not None and subject.replace(".", "", 1).isdecimal():
            self.context.replay.seek(float(subject))


def set_theme(gui: viser.GuiApi, *, dark: bool) -> None:
    """Set the page's theme, without viser's own logo and share button."""
    gui.configure_theme(dark_mode=dark, show_logo=False, show_share_button=False, control_width="large")
