"""The elements of the page's HTML. Every string from the wire goes through `text`."""

import math
from html import escape

from robrain.dashboard.state.robot_view import RobotHealth
from robrain.protocol.model.tasks.task import TaskState
from robrain.recording.drawing.palette import Rgb, css

NONE = "–"

CONDITIONS: dict[RobotHealth, tuple[str, str, str]] = {
    RobotHealth.UP: ("●", "up", "good"),
    RobotHealth.READY: ("○", "ready", "soft"),
    RobotHealth.ASTRAY: ("?", "astray", "bad"),
    RobotHealth.FAULTED: ("▲", "faulted", "bad"),
    RobotHealth.HALTED: ("■", "halted", "bad"),
    RobotHealth.SILENT: ("◐", "silent", "warn"),
    RobotHealth.LOST: ("✕", "lost", "bad"),
}
"""Shape, word and class of each: distinguishable without colours."""

TASK_STATES: dict[TaskState, tuple[str, str]] = {
    TaskState.QUEUED: ("○", "soft"),
    TaskState.OFFERED: ("◔", "soft"),
    TaskState.RUNNING: ("▶", "good"),
    TaskState.LOST_CONTACT: ("◐", "warn"),
    TaskState.DONE: ("✓", "good"),
    TaskState.FAILED: ("✕", "bad"),
    TaskState.CANCELLED: ("⊘", "soft"),
}
"""Shape and class of each."""
CLOSE_MARK = '<div class="rb-close-mark"></div>'
"""Marks the close button of a window, which follows it; Escape presses that button."""


def text(value: str, longest: int = 160) -> str:
    """A string from the wire as HTML text or attribute value, truncated if too long.

    >>> text("<b>")
    '&lt;b&gt;'
    """
    return escape(value if len(value) <= longest else value[: longest - 1] + "…")


def figure(value: float | None, form: str) -> str:
    """A figure in a format such as `{:.1f} m`; a dash if it is not known.

    >>> figure(1.25, "{:.1f} m"), figure(None, "{:.1f} m")
    ('1.2 m', '–')
    """
    return NONE if value is None or math.isnan(value) else form.format(value)


def tile(label: str, testid: str, value: str, kind: str = "") -> str:
    """A figure with its label; `kind` is good, warn, bad or nothing."""
    css_class = f' class="rb-{kind}"' if kind else ""
    return f'<div class="rb-tile"><span>{label}</span><b data-testid="{testid}"{css_class}>{value}</b></div>'


def note(words: str, testid: str = "") -> str:
    """A note in place of an empty table."""
    mark = f' data-testid="{testid}"' if testid else ""
    return f'<div class="rb"><div class="rb-none"{mark}>{words}</div></div>'


def banner(testid: str, html: str) -> str:
    """A conspicuous warning."""
    return f'<div class="rb-banner" data-testid="{testid}">{html}</div>'


def notice(testid: str, html: str) -> str:
    """Something to know that is no warning."""
    return f'<div class="rb-notice" data-testid="{testid}">{html}</div>'


def condition_html(condition: RobotHealth) -> str:
    """A robot's condition as shape and word."""
    shape, word, kind = CONDITIONS[condition]
    return f'<span class="rb-{kind}"><b>{shape}</b> {word}</span>'


def task_state_html(state: TaskState) -> str:
    """A task's state as shape and word."""
    shape, kind = TASK_STATES[state]
    return f'<span class="rb-{kind}">{shape} {state.value.replace("_", " ")}</span>'


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
