"""Tasks as HTML: the queue, and explanations. Every string from the wire is escaped."""

import re

from robrain.dashboard.html.html_words import NONE, clock_text, figure, note, task_state_html, text
from robrain.dashboard.state.team_view import TeamView
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.tasks.task_messages import RobotVerdict, TaskWhy
from robrain.protocol.model.tasks.task import TaskState
from robrain.recording.drawing.time_span import span_text

LONG_ID = re.compile(r"^(explore|recharge|[a-z_]+(?=-\d{8}))-\d+$")
"""Ids of the coordinator's own tasks, which contain no more than the kind."""
OPEN_ROWS = 60
ENDED_ROWS = 15


def queue_html(view: TeamView, *, is_live: bool, done: int = 0) -> str:
    """Open tasks, then those that ended last; `done` is the number that the team reports as done."""
    open_tasks = list(view.tasks.values())[-OPEN_ROWS:][::-1]
    open_tasks.sort(key=lambda event: (event.task.kind == "explore", event.state is not TaskState.RUNNING))
    ended = [event for event in list(view.board.ended)[::-1] if event.task.kind != "explore"][:ENDED_ROWS]
    if not open_tasks and not ended:
        unlisted = "Explorations, and tasks finished before this page was started, are not listed."
        return note(f"No open tasks. {unlisted}" if done else "No tasks yet.", "no-tasks")
    head = (
        '<tr><th style="width: 31%">Task</th><th style="width: 27%">State</th><th style="width: 14%">Robot</th>'
        '<th style="width: 28%"></th></tr>'
    )
    rows = "".join(_task_rows(event, is_live=is_live) for event in (*open_tasks, *ended))
    return f'<div class="rb"><table data-testid="tasks">{head}{rows}</table></div>'


def explanation_html(why: TaskWhy) -> str:
    """Why a task stands as it does: each robot's cost, or why it was ruled out, and the task's history."""
    record = why.record
    first_ns = why.changes[0].stamp_ns if why.changes else record.changed_ns
    head = (
        '<tr><th style="width: 18%">Robot</th><th class="rb-number" style="width: 16%">Way</th>'
        '<th class="rb-number" style="width: 16%">Energy</th><th class="rb-number" style="width: 15%">Time</th>'
        '<th style="width: 35%; padding-left: 14px">Verdict</th></tr>'
    )
    bids = "".join(_bid_row(verdict) for verdict in why.robots)
    table = f'<table data-testid="bids">{head}{bids}</table>'
    if not bids:
        table = '<div class="rb-none">No robot was judged yet.</div>'
    changes = "".join(
        f'<div class="rb-alert"><span class="rb-soft">{clock_text(max(0.0, (change.stamp_ns - first_ns) / 1e9))}</span>'
        f"<span>{task_state_html(change.state)} {text(change.robot, 40)} {text(change.why)}</span></div>"
        for change in why.changes
    )
    return (
        f'<div class="rb"><p data-testid="why-now">{text(why.now, 400)}</p><h4>What each robot would need</h4>{table}'
        f"<h4>What happened</h4>{changes or NONE}</div>"
    )


def _task_rows(event: TaskEvent, *, is_live: bool) -> str:
    task = event.task
    place = task.place
    name = text(task.id)
    short = "" if LONG_ID.match(task.id) else text(task.id.removeprefix(f"{task.kind}-"))
    acts = ""
    if is_live:
        acts = f'<button class="rb-act" data-rb="why {name}">why</button>'
        if not event.state.ended:
            acts += f' <button class="rb-act" data-rb="cancel {name}">cancel</button>'
    why = f" · {text(event.why)}" if event.why else ""
    where = f"{place.x_m:.1f}, {place.y_m:.1f} m"
    return (
        f'<tr class="rb-top"><td title="{name}"><b>{task.kind}</b> <span class="rb-soft">{short}</span></td>'
        f'<td data-testid="task-{name}-state">{task_state_html(event.state)}</td><td>'
        f"{text(event.robot, 40) or NONE}</td>"
        f'<td class="rb-number">{acts}</td></tr><tr class="rb-why"><td colspan="4">{where}{why}</td></tr>'
    )


def _bid_row(verdict: RobotVerdict) -> str:
    result = '<b class="rb-good">✓ chosen</b>' if verdict.chosen else text(verdict.why_not) or "could do it"
    distance_m = verdict.distance_m
    way = figure(distance_m, "{:.1f} m" if distance_m is not None and distance_m < 10 else "{:.0f} m")
    time = NONE if verdict.time_s is None else span_text(verdict.time_s)
    return (
        f'<tr class="rb-top"><td><b>{text(verdict.robot, 40)}</b></td><td class="rb-number">{way}</td>'
        f'<td class="rb-number">{figure(verdict.energy_j, "{:.0f} J")}</td><td class="rb-number">{time}</td>'
        f'<td style="white-space: normal; padding-left: 14px">{result}</td></tr>'
    )
