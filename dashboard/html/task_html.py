"""Tasks as HTML: the queue, explanations, and the plan as a Gantt chart; templates in `templates/tasks.html`."""

import re
from typing import NamedTuple

from robrain.dashboard.html.elements import placeholder, render
from robrain.dashboard.state.shown_robot import ShownRobot
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.tasks.task_messages import TaskExplanation
from robrain.protocol.model.tasks.task import TaskState
from robrain.recording.drawing.labels import natural_key
from robrain.recording.drawing.palette import css, style_of

LONG_ID = re.compile(r"^(explore|recharge|[a-z_]+(?=-\d{8}))-\d+$")
"""Ids of the coordinator's own tasks, which contain no more than the kind."""
OPEN_ROWS = 60
ENDED_ROWS = 15
GANTT_S = 300.0
"""Length of the past that is shown."""
SHORTEST_S = 60.0
LONGEST_S = 1800.0
"""Maximum length of the future that is shown."""
GANTT_ROBOTS = 40
WIDTH, ROW, LEFT = 396, 17, 44


def short_id(task_id: str) -> str:
    """A task's id, or only its kind if the coordinator created the task."""
    return LONG_ID.sub(r"\1", task_id)


def queue_html(view: ShownTeam, *, is_live: bool, done: int = 0) -> str:
    """Open tasks, then the tasks that ended last; `done` is the number that the team reports as done."""
    open_tasks = list(view.tasks.values())[-OPEN_ROWS:][::-1]
    open_tasks.sort(key=lambda event: (event.task.kind == "explore", event.state is not TaskState.RUNNING))
    ended = [event for event in list(view.board.ended)[::-1] if event.task.kind != "explore"][:ENDED_ROWS]
    if not open_tasks and not ended:
        unlisted = "Explorations, and tasks finished before this page was started, are not listed."
        return placeholder(f"No open tasks. {unlisted}" if done else "No tasks yet.", "no-tasks")
    estimates = {estimate.task: estimate for estimate in view.board.estimates.tasks}
    return render(
        "tasks", "queue", events=[*open_tasks, *ended], estimates=estimates, is_live=is_live, long_id=LONG_ID.match
    )


def explanation_html(explanation: TaskExplanation) -> str:
    """Explanation of a task's state: each robot's cost, or the reason of its exclusion, and the task's history."""
    first_ns = explanation.changes[0].stamp_ns if explanation.changes else explanation.record.changed_ns
    return render("tasks", "explanation", why=explanation, first_ns=first_ns)


class PlannedEntry(NamedTuple):
    """A planned task or charge of one robot; stamps of the run's clock."""

    start_ns: int
    end_ns: int
    title: str
    """From the wire: not escaped."""
    kind: str
    """`held`: the robot has the task already, and starts it by itself; `planned`; or `charge`."""


class Bar(NamedTuple):
    """A bar of the chart: its row, place and width in the picture."""

    row: int
    x: float
    width: float
    kind: str
    """As of `PlannedEntry`; or `running`, `done` or `failed`, which is any other end."""
    color: str
    title: str
    """From the wire: not escaped."""


def gantt_html(view: ShownTeam) -> str:
    """A row for each robot, over the run's time."""
    robots = sorted(view.robots.values(), key=lambda robot: natural_key(robot.name))[:GANTT_ROBOTS]
    if not robots or not view.board.spans:
        return placeholder("No robot has had a task yet.")
    now_ns = max([view.board.newest_ns, *(robot.state.stamp_ns for robot in robots if robot.state is not None)])
    expected = {robot.name: planned_entries(view, robot, now_ns) for robot in robots}
    until_s = max([60.0, *((entry.end_ns - now_ns) / 1e9 for entries in expected.values() for entry in entries)])
    first_ns = min((spans[0].start_ns for spans in view.board.spans.values() if spans), default=now_ns)
    start_s, end_s = max(-GANTT_S, min(-SHORTEST_S, (first_ns - now_ns) / 1e9)), min(until_s, LONGEST_S)
    scale = (WIDTH - LEFT) / (end_s - start_s)

    def x_of(stamp_ns: int) -> float:
        at_s = min(max((stamp_ns - now_ns) / 1e9, start_s), end_s)
        return LEFT + (at_s - start_s) * scale

    def bar(row: int, start_ns: int, end_ns: int, kind: str, color: str, title: str) -> Bar:
        left, right = x_of(start_ns), x_of(end_ns)
        return Bar(row, left, max(1.5, right - left), kind, color, title)

    bars = []
    for row, robot in enumerate(robots):
        color = css(style_of(robot.index).color)
        for span in view.board.spans.get(robot.name, ()):
            end_ns = span.end_ns if span.end_ns is not None else now_ns
            if x_of(end_ns) > LEFT:
                ended = "done" if span.state is TaskState.DONE else "failed"
                kind = "running" if span.end_ns is None else ended
                title = f"{span.kind} {span.task}: {span.state.value}"
                bars.append(bar(row, span.start_ns, end_ns, kind, color, title))
        for entry in expected[robot.name]:
            bars.append(bar(row, entry.start_ns, entry.end_ns, entry.kind, color, entry.title))
    return render(
        "tasks",
        "gantt",
        width=WIDTH,
        row=ROW,
        left=LEFT,
        height=ROW * len(robots) + 16,
        names=[robot.name for robot in robots],
        bars=bars,
        now_x=x_of(now_ns),
        start_s=start_s,
        end_s=end_s,
    )


def planned_entries(view: ShownTeam, robot: ShownRobot, now_ns: int) -> list[PlannedEntry]:
    """The rest of a robot's current task, its later tasks, and its charges, at their expected times."""
    found: list[PlannedEntry] = []
    estimates, next_task = view.board.estimates, None if robot.state is None else robot.state.next_task
    for estimate in estimates.tasks:
        task = estimate.task
        event, end_ns = view.tasks.get(task), estimates.stamp_ns + to_ns(estimate.ends_in_s)
        if event is None or estimate.robot != robot.name or end_ns <= now_ns:
            continue
        start_ns, title = estimates.stamp_ns + to_ns(estimate.starts_in_s), f"{event.task.kind} {task}"
        if event.state is TaskState.RUNNING:
            found.append(PlannedEntry(now_ns, end_ns, f"{title}: still to do", "held"))
        elif next_task is not None and next_task.id == task:
            found.append(PlannedEntry(start_ns, end_ns, f"{title}: next at the robot", "held"))
        else:
            found.append(PlannedEntry(start_ns, end_ns, f"{title}: planned", "planned"))
    found += [
        PlannedEntry(max(charge.from_ns, now_ns), charge.until_ns, f"charging to {100 * charge.to_soc:.0f} %", "charge")
        for charge in view.charges
        if charge.robot == robot.name and charge.until_ns > now_ns
    ]
    return found
