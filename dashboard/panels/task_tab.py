"""The tab of tasks: a form for new ones, the queue, and the plan."""

import secrets
from typing import Any

import msgspec
import viser

from robrain.client.submission import BadTask, submission_of
from robrain.dashboard.html.elements import CLOSE_MARK, cut, render
from robrain.dashboard.html.task_html import explanation_html, gantt_html, queue_html
from robrain.dashboard.panels.function_form import FormField, FormPanel, fields_of
from robrain.dashboard.panels.gui_values import on_choice, set_html, set_value
from robrain.dashboard.panels.page import BY, Page, RowActions, Tab
from robrain.protocol.messages.tasks.plan_messages import COORDINATOR_OBJECTIVE, ObjectiveRequest, PlanningStatus
from robrain.protocol.messages.tasks.task_messages import (
    TASK_CANCEL,
    TASK_EXPLAIN,
    TASK_SUBMIT,
    KnownKind,
    TaskExplanation,
    TaskRecord,
    TaskRequest,
    TaskSubmission,
)
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.model.tasks.stock_kinds import EXPLORE, VISIT
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.schema.announced_parameters import check_announced

HIDDEN = {"id", "kind", "parameters", "earliest_ns", "deadline_ns", "needs", "after", "robots", "excluded", "paused"}
"""Fields of tasks that the form leaves to scripts, and the id, which is generated."""
GANTT_PERIOD_S = 1.0
BELOW_THE_FORM = 1e9
"""Order of the button: the form is rebuilt for each kind of task, and would otherwise come after it."""
BY_CLICK, BY_CLICK_WAITS = "Click on the map to add a task", "Now click on the map (or here to cancel)"


class TaskTab(Tab):
    """The tab of one page."""

    title, icon = "Tasks", viser.Icon.LIST_CHECK

    def __init__(self, page: Page) -> None:
        gui = page.client.gui
        self._page = page
        self._wants_place = False
        """Whether the next click on the map is a place for a new task."""
        self._drawn_s: float | None = None
        self._known_objective: Objective | None = None
        live = page.context.is_live
        self._summary = gui.add_html("")
        with gui.add_folder("Add a task", visible=live):
            self._by_click = gui.add_button(BY_CLICK, color="blue")
            self._by_click.on_click(lambda _: page.post(lambda: self._want_place(not self._wants_place)))
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

    def row_actions(self) -> RowActions:
        """`why` explains a task, `cancel` cancels it."""
        return {"why": self.explain, "cancel": self.cancel}

    def accept_place(self, place: Point2D) -> bool:
        """Add the task of the form at a place that was clicked, if a person wants that."""
        if not self._wants_place:
            return False
        self._want_place(False)
        self._form.set("place.x_m", f"{place.x_m:.2f}")
        self._form.set("place.y_m", f"{place.y_m:.2f}")
        self._add()
        return True

    def cancel(self, task: str) -> None:
        """Cancel a task."""

        def show(_: TaskRecord | None, error: str) -> None:
            self._page.notify(f"Cancel {task}", "done", error=error)

        request = TaskRequest(id=task, by=BY, why="cancelled on the dashboard")
        self._page.context.asker.ask(TASK_CANCEL, request, show)

    def explain(self, task: str) -> None:
        """Show why a task stands as it does, in a window of this browser alone."""

        def show(explanation: TaskExplanation | None, error: str) -> None:
            html = render("elements", "message", kind="bad", words=cut(error, 400))
            if explanation is not None:
                html = explanation_html(explanation)
            gui = self._page.client.gui
            modal = gui.add_modal(f"Why: {task[:40]}")
            with modal:
                gui.add_html(html)
                gui.add_html(CLOSE_MARK)
                gui.add_button("Close").on_click(lambda _: self._page.post(modal.close))

        self._page.context.asker.ask(TASK_EXPLAIN, TaskRequest(id=task, by=BY), show, timeout_s=TASK_EXPLAIN.timeout_s)

    def _want_place(self, wants: bool) -> None:
        self._wants_place = wants
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

        def show(record: TaskRecord | None, error: str) -> None:
            if record is None:
                self._show("bad", f"✕ {error}")
            else:
                self._show("good", f"✓ {record.task.id} is {record.state.value}")

        self._page.context.asker.ask(TASK_SUBMIT, submission, show)

    def _show(self, kind: str, words: str) -> None:
        set_html(self._status, render("elements", "message", kind=kind, words=cut(words, 400), testid="task-told"))

    def _draw_planning(self) -> None:
        status = self._page.context.inquiries.planning
        if status is None:
            set_html(self._planning, "")
            return
        if status.objective != self._known_objective:  # else keep the user's last choice
            self._known_objective = status.objective
            set_value(self._objective, status.objective)
        set_html(self._planning, render("tasks", "planning", status=status))

    def _set_objective(self, objective: Objective) -> None:
        def show(_: PlanningStatus | None, error: str) -> None:
            self._page.notify("Planning", f"objective from now on: {objective}", error=error)

        request = ObjectiveRequest(objective=objective, by=BY)
        self._page.context.asker.ask(COORDINATOR_OBJECTIVE, request, show)


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
