"""Tasks as HTML: the queue, who does what when, and why. Every string that came over the wire is escaped."""

from robrain.coordinator.dashboard.palette import css, look_of
from robrain.coordinator.dashboard.task_board import Span
from robrain.coordinator.dashboard.team_view import TeamView
from robrain.coordinator.dashboard.words import NONE, clock_text, natural_key, span_text, task_state_html, text
from robrain.protocol.model.task import TaskState, kind_of, place_of
from robrain.protocol.wire.messages import TaskEvent
from robrain.protocol.wire.task_messages import RobotVerdict, TaskWhy

OPEN_ROWS = 60
ENDED_ROWS = 15
GANTT_S = 300.0
"""What has been is shown for so long."""
SHORTEST_S = 60.0
GANTT_ROBOTS = 40
WIDTH, ROW, LEFT = 396, 17, 44


def queue_html(view: TeamView, *, is_live: bool) -> str:
    """Open tasks, then those that ended last."""
    open_tasks = list(view.tasks.values())[-OPEN_ROWS:][::-1]
    open_tasks.sort(key=lambda event: (kind_of(event.task) == "explore", event.state is not TaskState.RUNNING))
    ended = [event for event in list(view.board.ended)[::-1] if kind_of(event.task) != "explore"][:ENDED_ROWS]
    if not open_tasks and not ended:
        return '<div class="rb"><div class="rb-none" data-testid="no-tasks">No task has been heard of yet.</div></div>'
    head = (
        '<tr><th style="width: 31%">Task</th><th style="width: 27%">State</th><th style="width: 14%">Robot</th>'
        '<th style="width: 28%"></th></tr>'
    )
    rows = "".join(_task_rows(event, is_live=is_live) for event in open_tasks)
    rows += "".join(_task_rows(event, is_live=is_live) for event in ended)
    return f'<div class="rb"><table data-testid="tasks">{head}{rows}</table></div>'


def gantt_html(view: TeamView) -> str:
    """A row for each robot: what it did, what it is at, and what is planned for it, over the run's time."""
    robots = sorted(view.robots.values(), key=lambda robot: natural_key(robot.name))[:GANTT_ROBOTS]
    now_ns = max([view.board.newest_ns, *(robot.state.stamp_ns for robot in robots if robot.state is not None)])
    if not robots or not view.board.spans:
        return '<div class="rb"><div class="rb-none">No robot has had a task yet.</div></div>'
    planned = view.board.planned()
    until_s = max(
        [60.0, *((span.end_ns or now_ns) / 1e9 - now_ns / 1e9 for spans in planned.values() for span in spans)]
    )
    first_ns = min((spans[0].start_ns for spans in view.board.spans.values() if spans), default=now_ns)
    start_s, end_s = max(-GANTT_S, min(-SHORTEST_S, (first_ns - now_ns) / 1e9)), min(until_s, 1800.0)
    scale = (WIDTH - LEFT) / (end_s - start_s)

    def x_of(stamp_ns: int) -> float:
        at_s = min(max((stamp_ns - now_ns) / 1e9, start_s), end_s)
        return LEFT + (at_s - start_s) * scale

    height = ROW * len(robots) + 16
    parts = []
    for number, robot in enumerate(robots):
        y = number * ROW
        color = css(look_of(robot.index).color)
        parts.append(f'<text x="0" y="{y + 12}">{text(robot.name, 7)}</text>')
        parts.append(f'<line class="rb-axis" x1="{LEFT}" x2="{WIDTH}" y1="{y + ROW}" y2="{y + ROW}"/>')
        for span in [*view.board.spans.get(robot.name, ()), *planned.get(robot.name, ())]:
            left, right = x_of(span.start_ns), x_of(span.end_ns if span.end_ns is not None else now_ns)
            if right > LEFT:
                parts.append(_bar(span, left, right, y, color, is_planned=span.start_ns > now_ns))
    now_x = x_of(now_ns)
    parts.append(
        f'<line x1="{now_x:.0f}" x2="{now_x:.0f}" y1="0" y2="{height - 14}" stroke="#c81e1e" stroke-width="1.5"/>'
    )
    parts.append(f'<text class="rb-dim" x="{LEFT}" y="{height - 2}">{span_text(-start_s)} ago</text>')
    parts.append(f'<text class="rb-dim" x="{now_x:.0f}" y="{height - 2}" text-anchor="middle">now</text>')
    picture = f'<svg viewBox="0 0 {WIDTH} {height}" width="100%" data-testid="gantt">{"".join(parts)}</svg>'
    legend = (
        "<span>▬ pale: done</span><span>full: at it</span><span>dashed: planned</span><span>outlined: not done</span>"
    )
    return f'<div class="rb">{picture}<div class="rb-legend">{legend}</div></div>'


def why_html(why: TaskWhy) -> str:
    """Why a task stands as it does: each robot's cost, or why it was ruled out, and the task's history."""
    record = why.record
    first_ns = why.changes[0].stamp_ns if why.changes else record.changed_ns
    head = (
        '<tr><th style="width: 18%">Robot</th><th class="rb-number" style="width: 16%">Way</th>'
        '<th class="rb-number" style="width: 16%">Energy</th><th class="rb-number" style="width: 15%">Time</th>'
        '<th style="width: 35%; padding-left: 14px">Verdict</th></tr>'
    )
    bids = "".join(_bid_row(verdict) for verdict in why.robots)
    table = (
        f'<table data-testid="bids">{head}{bids}</table>'
        if bids
        else '<div class="rb-none">No robot was judged yet.</div>'
    )
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
    place = place_of(task)
    name = text(task.id)
    short = text(task.id.removeprefix(f"{kind_of(task)}-"))
    acts = ""
    if is_live:
        acts = f'<button class="rb-act" data-rb="why {name}">why</button>'
        if not event.state.ended:
            acts += f' <button class="rb-act" data-rb="cancel {name}">cancel</button>'
    why = f" · {text(event.why)}" if event.why else ""
    where = f"{place.x_m:.1f}, {place.y_m:.1f} m"
    return (
        f'<tr class="rb-top"><td title="{name}"><b>{kind_of(task)}</b> <span class="rb-soft">{short}</span></td>'
        f'<td data-testid="task-{name}-state">{task_state_html(event.state)}</td><td>'
        f"{text(event.robot, 40) or NONE}</td>"
        f'<td class="rb-number">{acts}</td></tr><tr class="rb-why"><td colspan="4">{where}{why}</td></tr>'
    )


def _bid_row(verdict: RobotVerdict) -> str:
    def number(value: float | None, unit: str) -> str:
        return NONE if value is None else f"{value:.0f} {unit}"

    said = '<b class="rb-good">✓ chosen</b>' if verdict.chosen else text(verdict.why_not) or "could do it"
    time = NONE if verdict.time_s is None else span_text(verdict.time_s)
    return (
        f'<tr class="rb-top"><td><b>{text(verdict.robot, 40)}</b></td>'
        f'<td class="rb-number">{NONE if verdict.distance_m is None else f"{verdict.distance_m:.1f} m"}</td>'
        f'<td class="rb-number">{number(verdict.energy_j, "J")}</td><td class="rb-number">{time}</td>'
        f'<td style="white-space: normal; padding-left: 14px">{said}</td></tr>'
    )


def _bar(span: Span, left: float, right: float, y: int, color: str, *, is_planned: bool) -> str:
    width = max(1.5, right - left)
    title = f"<title>{text(span.kind, 20)} {text(span.task)}: {span.state.value}</title>"
    look = f'fill="{color}"'
    if is_planned:
        look = f'fill="none" stroke="{color}" stroke-dasharray="3 2"'
    elif span.end_ns is not None and span.state is not TaskState.DONE:
        look = f'fill="{color}" fill-opacity="0.3" stroke="#c85a1e"'
    elif span.end_ns is not None:
        look = f'fill="{color}" fill-opacity="0.65"'
    return f'<rect x="{left:.1f}" y="{y + 3}" width="{width:.1f}" height="{ROW - 6}" rx="2" {look}>{title}</rect>'
