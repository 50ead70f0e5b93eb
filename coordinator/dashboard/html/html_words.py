"""Small pieces that all of the page's HTML is made of. Every string that came over the wire goes through `text`."""

from html import escape

from robrain.coordinator.dashboard.state.robot_view import Condition
from robrain.coordinator.drawing.palette import Rgb, css
from robrain.protocol.model.tasks.task import TaskState

NONE = "–"

CONDITIONS: dict[Condition, tuple[str, str, str]] = {
    Condition.UP: ("●", "up", "good"),
    Condition.ASTRAY: ("?", "astray", "bad"),
    Condition.FAULTED: ("▲", "faulted", "bad"),
    Condition.HALTED: ("■", "halted", "bad"),
    Condition.SILENT: ("◐", "silent", "warn"),
    Condition.LOST: ("✕", "lost", "bad"),
}
"""Shape, word and class of each: told apart without colours."""

TASK_SHAPES: dict[TaskState, str] = {
    TaskState.QUEUED: "○",
    TaskState.OFFERED: "◔",
    TaskState.RUNNING: "▶",
    TaskState.LOST_CONTACT: "◐",
    TaskState.DONE: "✓",
    TaskState.FAILED: "✕",
    TaskState.CANCELLED: "⊘",
}
TASK_CLASSES: dict[TaskState, str] = {
    TaskState.DONE: "good",
    TaskState.RUNNING: "good",
    TaskState.FAILED: "bad",
    TaskState.LOST_CONTACT: "warn",
}


def text(value: str, longest: int = 160) -> str:
    """A string of the wire as HTML text or attribute value, cut off where it is too long.

    >>> text("<b>")
    '&lt;b&gt;'
    """
    return escape(value if len(value) <= longest else value[: longest - 1] + "…")


def tile(label: str, testid: str, value: str, kind: str = "") -> str:
    """A figure with its label; `kind` is good, warn, bad or nothing."""
    css_class = f' class="rb-{kind}"' if kind else ""
    return f'<div class="rb-tile"><span>{label}</span><b data-testid="{testid}"{css_class}>{value}</b></div>'


def banner(testid: str, html: str) -> str:
    """What nobody may overlook."""
    return f'<div class="rb-banner" data-testid="{testid}">{html}</div>'


def condition_html(condition: Condition) -> str:
    """A robot's condition as shape and word."""
    shape, word, kind = CONDITIONS[condition]
    return f'<span class="rb-{kind}"><b>{shape}</b> {word}</span>'


def task_state_html(state: TaskState) -> str:
    """A task's state as shape and word."""
    kind = TASK_CLASSES.get(state, "soft")
    return f'<span class="rb-{kind}">{TASK_SHAPES[state]} {state.value.replace("_", " ")}</span>'


def colored(shape: str, color: Rgb) -> str:
    """A shape in a robot's own colour."""
    return f'<span style="color: {css(color)}">{shape}</span>'


def clock_text(time_s: float) -> str:
    """Seconds as minutes or hours.

    >>> clock_text(75.4), clock_text(3725)
    ('1:15', '1:02:05')
    """
    minutes, seconds = divmod(int(time_s), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"


def span_text(time_s: float) -> str:
    """A duration in the unit that people would use.

    >>> span_text(42.0), span_text(500.0), span_text(9000.0)
    ('42 s', '8 min', '2.5 h')
    """
    if time_s < 100:
        return f"{time_s:.0f} s"
    return f"{time_s / 60:.0f} min" if time_s < 6000 else f"{min(time_s / 3600, 9999):.1f} h"


def natural_key(name: str) -> list[tuple[int, str]]:
    """Sorts r2 before r10.

    >>> sorted(["r10", "r2"], key=natural_key)
    ['r2', 'r10']
    """
    parts: list[tuple[int, str]] = []
    digits = ""
    for char in [*name, ""]:
        if char.isdecimal():
            digits += char
            continue
        if digits:
            parts.append((int(digits), ""))
            digits = ""
        parts.append((-1, char))
    return parts
