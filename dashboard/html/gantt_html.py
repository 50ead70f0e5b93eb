"""A Gantt chart as SVG: past, current and planned tasks and charges of each robot."""

from typing import NamedTuple

from robrain.dashboard.html.html_words import note, text
from robrain.dashboard.state.robot_view import RobotView
from robrain.dashboard.state.task_board import PLANNED_S, Span
from robrain.dashboard.state.team_view import TeamView
from robrain.protocol.model.tasks.task import TaskState
from robrain.recording.drawing.natural_order import natural_key
from robrain.recording.drawing.palette import CHARGER_PLATE, css, style_of
from robrain.recording.drawing.time_span import span_text

GANTT_S = 300.0
"""Length of the past that is shown."""
SHORTEST_S = 60.0
LONGEST_S = 1800.0
"""Maximum length of the future that is shown."""
GANTT_ROBOTS = 40
WIDTH, ROW, LEFT = 396, 17, 44
LEGEND = (
    "<span>▬ pale: done</span><span>full: at it</span><span>dashed: planned</span>"
    "<span>pale, dashed: the rest, what is held ready</span><span>⚡ charging</span><span>outlined: not done</span>"
)


class Foreseen(NamedTuple):
    """A planned task or charge of one robot; stamps of the run's clock."""

    start_ns: int
    end_ns: int
    title: str
    """From the wire: not escaped."""
    is_held: bool = False
    """The robot has the task already, and starts it by itself."""
    is_charge: bool = False


def gantt_html(view: TeamView) -> str:
    """A row for each robot, over the run's time."""
    robots = sorted(view.robots.values(), key=lambda robot: natural_key(robot.name))[:GANTT_ROBOTS]
    if not robots or not view.board.spans:
        return note("No robot has had a task yet.")
    now_ns = max([view.board.newest_ns, *(robot.state.stamp_ns for robot in robots if robot.state is not None)])
    expected = {robot.name: foreseen(view, robot, now_ns) for robot in robots}
    until_s = max([60.0, *((entry.end_ns - now_ns) / 1e9 for entries in expected.values() for entry in entries)])
    first_ns = min((spans[0].start_ns for spans in view.board.spans.values() if spans), default=now_ns)
    start_s, end_s = max(-GANTT_S, min(-SHORTEST_S, (first_ns - now_ns) / 1e9)), min(until_s, LONGEST_S)
    scale = (WIDTH - LEFT) / (end_s - start_s)

    def x_of(stamp_ns: int) -> float:
        at_s = min(max((stamp_ns - now_ns) / 1e9, start_s), end_s)
        return LEFT + (at_s - start_s) * scale

    height = ROW * len(robots) + 16
    parts = []
    for number, robot in enumerate(robots):
        y = number * ROW
        color = css(style_of(robot.index).color)
        parts.append(f'<text x="0" y="{y + 12}">{text(robot.name, 7)}</text>')
        parts.append(f'<line class="rb-axis" x1="{LEFT}" x2="{WIDTH}" y1="{y + ROW}" y2="{y + ROW}"/>')
        for span in view.board.spans.get(robot.name, ()):
            left, right = x_of(span.start_ns), x_of(span.end_ns if span.end_ns is not None else now_ns)
            if right > LEFT:
                parts.append(_bar(span, left, right, y, color))
        for entry in expected[robot.name]:
            parts.append(_foreseen_bar(entry, x_of(entry.start_ns), x_of(entry.end_ns), y, color))
    now_x = x_of(now_ns)
    parts.append(
        f'<line x1="{now_x:.0f}" x2="{now_x:.0f}" y1="0" y2="{height - 14}" stroke="#c81e1e" stroke-width="1.5"/>'
    )
    parts.append(f'<text class="rb-dim" x="{LEFT}" y="{height - 2}">{span_text(-start_s)} ago</text>')
    parts.append(f'<text class="rb-dim" x="{now_x:.0f}" y="{height - 2}" text-anchor="middle">now</text>')
    ahead = f"in {span_text(end_s)}"
    parts.append(f'<text class="rb-dim" x="{WIDTH}" y="{height - 2}" text-anchor="end">{ahead}</text>')
    picture = f'<svg viewBox="0 0 {WIDTH} {height}" width="100%" data-testid="gantt">{"".join(parts)}</svg>'
    return f'<div class="rb">{picture}<div class="rb-legend">{LEGEND}</div></div>'


def foreseen(view: TeamView, robot: RobotView, now_ns: int) -> list[Foreseen]:
    """The rest of a robot's current task, its next task, its planned tasks, and its charges."""
    found: list[Foreseen] = []
    state = robot.state
    free_ns = now_ns
    if state is not None and state.task is not None and state.task.left_s is not None and not state.task.state.ended:
        free_ns = max(now_ns, state.stamp_ns + round(state.task.left_s * 1e9))
        found.append(Foreseen(now_ns, free_ns, f"{state.task.id}: the rest of it", is_held=True))
    planned = view.board.planned().get(robot.name, [])
    held = state.next_task.id if state is not None and state.next_task is not None else ""
    if held:
        known = next((span for span in planned if span.task == held), None)
        length_ns = round(PLANNED_S * 1e9) if known is None or known.end_ns is None else known.end_ns - known.start_ns
        event = view.tasks.get(held)
        kind = event.task.kind if event is not None else "task"
        found.append(Foreseen(free_ns, free_ns + length_ns, f"{kind} {held}: held ready", is_held=True))
    found += [
        Foreseen(span.start_ns, span.end_ns, f"{span.kind} {span.task}: planned")
        for span in planned
        if span.task != held and span.end_ns is not None and span.end_ns > now_ns
    ]
    found += [
        Foreseen(max(charge.from_ns, now_ns), charge.until_ns, f"charging to {100 * charge.to_soc:.0f} %", False, True)
        for charge in view.charges
        if charge.robot == robot.name and charge.until_ns > now_ns
    ]
    return found


def _bar(span: Span, left: float, right: float, y: int, color: str) -> str:
    look = f'fill="{color}"'
    if span.end_ns is not None and span.state is not TaskState.DONE:
        look = f'fill="{color}" fill-opacity="0.3" stroke="#c85a1e"'
    elif span.end_ns is not None:
        look = f'fill="{color}" fill-opacity="0.65"'
    return _rect(left, right, y, look, f"{span.kind} {span.task}: {span.state.value}")


def _foreseen_bar(entry: Foreseen, left: float, right: float, y: int, color: str) -> str:
    if entry.is_charge:
        bar = _rect(left, right, y, f'fill="{css(CHARGER_PLATE)}" stroke="{color}"', entry.title)
        return f'{bar}<text x="{left + 2:.1f}" y="{y + 12}" style="fill: #f0e442" pointer-events="none">⚡</text>'
    fill = f'fill="{color}" fill-opacity="0.25"' if entry.is_held else 'fill="none"'
    return _rect(left, right, y, f'{fill} stroke="{color}" stroke-dasharray="3 2"', entry.title)


def _rect(left: float, right: float, y: int, look: str, title: str) -> str:
    width = max(1.5, right - left)
    return (
        f'<rect x="{left:.1f}" y="{y + 3}" width="{width:.1f}" height="{ROW - 6}" rx="2" {look}>'
        f"<title>{text(title)}</title></rect>"
    )
