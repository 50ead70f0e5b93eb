"""The tab of the tasks: new ones by form or by a click on the map, the queue, who does what when, and why."""

import secrets
from typing import Any

import msgspec
import viser

from robrain.coordinator.dashboard.html.gantt_html import gantt_html
from robrain.coordinator.dashboard.html.html_words import text
from robrain.coordinator.dashboard.html.task_html import queue_html, why_html
from robrain.coordinator.dashboard.panels.form_panel import FormPanel
from robrain.coordinator.dashboard.panels.function_form import Field, fields_of
from robrain.coordinator.dashboard.panels.gui_values import set_html, set_value
from robrain.coordinator.dashboard.panels.page_context import BY, Page, stock_kinds
from robrain.coordinator.dashboard.server.asker import Answer
from robrain.coordinator.dashboard.server.page_head import CLOSE_MARK
from robrain.coordinator.tasks.announced_parameters import check_announced
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.model.tasks.stock_kinds import EXPLORE
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.wire.messages.plan_messages import ObjectiveRequest, PlanningStatus
from robrain.protocol.wire.messages.task_messages import KnownKind, TaskRecord, TaskRequest, TaskSubmission, TaskWhy
from robrain.protocol.wire.topics import COORDINATOR_OBJECTIVE, TASK_CANCEL, TASK_SUBMIT, TASK_WHY

HIDDEN = {"id", "kind", "parameters", "earliest_ns", "deadline_ns", "needs", "after", "robots"}
"""Fields of tasks that the form does not have: it makes the id itself, and scripts have the rest."""
DEADLINE = "deadline_in_s"
GANTT_PERIOD_S = 1.0
BELOW_THE_FORM = 1e9
"""Order of the button: the form is rebuilt for each kind of task, and would otherwise come after it."""
BY_CLICK, BY_CLICK_WAITS = "Click on the map to add a task", "Now click on the map (or here to cancel)"


class TaskTab:
    """Built within the tab's context."""

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
            self._kind = gui.add_dropdown("Kind", tuple(self._kinds))
            self._kind.on_update(lambda event: page.post(lambda: self._choose(event.target.value)))
            self._told = gui.add_html("")
            self._slot = gui.add_folder("Coordinates and options", expand_by_default=False)
            self._form = FormPanel(gui, self._make_form)
            with self._slot:
                add = gui.add_button("Add task at these coordinates", color="gray", order=BELOW_THE_FORM)
            add.on_click(lambda _: page.post(self._add))
        with gui.add_folder("Queue"):
            self._queue = gui.add_html("")
        with gui.add_folder("Plan"):
            self._objective = gui.add_dropdown("Objective", tuple(Objective), visible=live)
            self._objective.on_update(self._choose_objective)
            self._planning = gui.add_html("")
            self._gantt = gui.add_html("")
        self._choose(self._kind.value)

    def draw(self, now_s: float) -> None:
        """Bring it up to date."""
        context = self._page.context
        view = context.view
        waiting = sum(event.robot == "" for event in view.tasks.values())
        done = view.team.tasks_done if view.team is not None else sum(e.state == "done" for e in view.board.ended)
        set_html(
            self._summary,
            f'<div class="rb rb-strip" data-testid="task-summary">{len(view.tasks)} open, {waiting} of them without a '
            f"robot; {done} done</div>",
        )
        set_html(self._queue, queue_html(view, is_live=context.is_live, done=done))
        if self._drawn_s is None or now_s - self._drawn_s >= GANTT_PERIOD_S:
            self._drawn_s = now_s
            set_html(self._gantt, gantt_html(view))
            self._draw_planning()
            self._follow_kinds()

    # -- adding ---------------------------------------------------------------------------------------------

    def place(self, place: Point2D) -> None:
        """Add the task of the form at a place that was clicked."""
        self._want_place(False)
        for label, value in (("place.x_m", place.x_m), ("place.y_m", place.y_m)):
            self._form.set(label, f"{value:.2f}")
        self._add()

    def _want_place(self, wants: bool) -> None:
        self.wants_place = wants
        self._by_click.label = BY_CLICK_WAITS if wants else BY_CLICK
        self._by_click.color = "orange" if wants else "blue"

    def _make_form(self) -> viser.GuiFolderHandle:
        with self._slot:
            return self._page.client.gui.add_form(None)

    def _choose(self, kind: str) -> None:
        if kind in self._kinds:
            self._form.show(task_fields(self._kinds[kind]))

    def _known_kinds(self) -> dict[str, KnownKind]:
        """Kinds that a person may ask for, by name; of one that robots announce differently the first."""
        inquiries = self._page.context.inquiries
        known = stock_kinds() if inquiries is None else inquiries.kinds
        return {one.kind: one for one in reversed(known) if one.kind != EXPLORE}

    def _follow_kinds(self) -> None:
        kinds = self._known_kinds()
        if kinds == self._kinds:
            return
        chosen, self._kinds = self._kind.value, kinds
        names = tuple(sorted(kinds))
        if names != tuple(self._kind.options):
            self._kind.options = names  # viser keeps the value if it is still there
            if chosen in kinds:
                set_value(self._kind, chosen)
        self._choose(self._kind.value)

    def _add(self) -> None:
        try:
            submission = submission_of(self._kinds[self._kind.value], self._form.arguments())
        except ValueError as error:
            self._tell("bad", f"✕ {error}")
            return
        self._tell("soft", f"{submission.task.id}: sent …")

        def take(answer: Answer[TaskRecord]) -> None:
            try:
                record = answer.reply
            except ValueError as error:
                self._tell("bad", f"✕ {error}")
            else:
                self._tell("good", f"✓ {record.task.id} is {record.state.value}")

        self._page.context.ask(TASK_SUBMIT, submission, take)

    def _tell(self, kind: str, said: str) -> None:
        set_html(self._told, f'<div class="rb rb-{kind}" data-testid="task-told">{text(said, 400)}</div>')

    # -- asking and ending ----------------------------------------------------------------------------------

    def cancel(self, task: str) -> None:
        """Call a task off."""
        if not self._page.context.is_live:
            return

        def take(answer: Answer[TaskRecord]) -> None:
            self._page.tell(f"Cancel {task}", answer.error or "done", color="red" if answer.error else "green")

        request = TaskRequest(id=task, by=BY, why="cancelled on the dashboard")
        self._page.context.ask(TASK_CANCEL, request, take)

    def ask_why(self, task: str) -> None:
        """Show why a task stands as it does, in a window of this browser alone."""
        if not self._page.context.is_live:
            return

        def take(answer: Answer[TaskWhy]) -> None:
            try:
                html = why_html(answer.reply)
            except ValueError as error:
                html = f'<div class="rb rb-bad">{text(str(error), 400)}</div>'
            gui = self._page.client.gui
            modal = gui.add_modal(f"Why: {task[:40]}")
            with modal:
                gui.add_html(html)
                gui.add_html(CLOSE_MARK)
                gui.add_button("Close").on_click(lambda _: self._page.post(modal.close))

        self._page.context.ask(TASK_WHY, TaskRequest(id=task, by=BY), take)

    # -- planning -------------------------------------------------------------------------------------------

    def _draw_planning(self) -> None:
        inquiries = self._page.context.inquiries
        status = inquiries.planning if inquiries is not None else None
        if status is None:
            set_html(self._planning, "")
            return
        if status.objective != self._known_objective:  # else leave what somebody has just chosen
            self._known_objective = status.objective
            set_value(self._objective, status.objective)
        set_html(
            self._planning,
            f'<div class="rb rb-soft" data-testid="planning">{text(status.method, 40)}: {status.plans} plans, '
            f"the last in {1000 * status.took_s:.0f} ms; {status.planned} tasks planned, {status.left_out} left out"
            "</div>",
        )

    def _choose_objective(self, event: viser.GuiEvent[Any]) -> None:
        if event.client is None:
            return
        request = ObjectiveRequest(objective=Objective(event.target.value), by=BY)

        def take(answer: Answer[PlanningStatus]) -> None:
            said = answer.error or f"objective from now on: {request.objective}"
            self._page.tell("Planning", said, color="red" if answer.error else "green")

        self._page.post(lambda: self._page.context.ask(COORDINATOR_OBJECTIVE, request, take))


def task_fields(kind: KnownKind) -> list[Field]:
    """The fields of the form for a kind of task, whose schema may be a stranger's."""
    (_,), definitions = msgspec.json.schema_components([Task])
    common, own = definitions["Task"], kind.parameters
    properties, its_own = own.get("properties"), own.get("$defs")
    definitions = (its_own if isinstance(its_own, dict) else {}) | definitions
    given = properties if isinstance(properties, dict) else {}
    shown = {name: shape for name, shape in (given | common["properties"]).items() if name not in HIDDEN}
    needed = own.get("required")
    required = [*common["required"], *(needed if isinstance(needed, list) else [])]
    order = sorted(shown, key=lambda name: (name != "place", name not in required))
    properties = {name: shown[name] for name in order} | {DEADLINE: {"type": "number"}}
    return fields_of({"properties": properties, "required": required, "$defs": definitions})


def submission_of(known: KnownKind, arguments: dict[str, Any]) -> TaskSubmission:
    """A new task of the form's arguments, with an id of its own.

    Raises:
        ValueError: an argument is impossible for such a task.

    """
    given = dict(arguments)
    deadline_in_s = given.pop(DEADLINE, None)
    common = {field.name for field in msgspec.structs.fields(Task)}
    parameters = {name: given.pop(name) for name in list(given) if name not in common}
    kind = known.kind
    named = {"kind": kind, "id": f"{kind}-{secrets.token_hex(3)}", "parameters": parameters}
    task = msgspec.convert({**given, **named}, Task)
    check_announced(kind, task.parameters, [known.parameters])
    return TaskSubmission(task=task, by=BY, deadline_in_s=deadline_in_s)
