"""The page's HTML: jinja templates, which escape every string, and the shapes and formats that they use."""

import math
from functools import cache

import jinja2
from jinja2.environment import TemplateModule

from robrain.dashboard.state.shown_robot import RobotHealth
from robrain.protocol.model.tasks.task import TaskState
from robrain.recording.drawing.labels import span_text
from robrain.recording.drawing.palette import CHARGER_PLATE, battery_class, css, mote_class, style_of

NONE = "–"
"""A value that is not known."""
TEXT_MAX = 160

CONDITIONS: dict[RobotHealth, tuple[str, str, str]] = {
    RobotHealth.UP: ("●", "up", "good"),
    RobotHealth.READY: ("○", "ready", "soft"),
    RobotHealth.OUT_OF_SERVICE: ("◇", "out of service", "soft"),
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


def render(template: str, macro: str, **values: object) -> str:
    """The HTML of one macro of a template in `templates/`; every string of the values is escaped."""
    return str(getattr(_macros(f"{template}.html"), macro)(**values))


def placeholder(words: str, testid: str = "") -> str:
    """A note in place of an empty table."""
    return render("elements", "placeholder", words=words, testid=testid)


def cut(value: str, longest: int = TEXT_MAX) -> str:
    """A string from the wire, truncated if it is too long."""
    return value if len(value) <= longest else value[: longest - 1] + "…"


def figure(value: float | None, form: str) -> str:
    """A figure in a format such as `{:.1f} m`; a dash if it is not known.

    >>> figure(1.25, "{:.1f} m"), figure(None, "{:.1f} m")
    ('1.2 m', '–')
    """
    return NONE if value is None or math.isnan(value) else form.format(value)


def percent(share: float | None) -> str:
    """A share of 1 in whole percent; a dash if it is not known."""
    return NONE if share is None or math.isnan(share) else f"{100 * share:.0f} %"


def clock_text(time_s: float) -> str:
    """Seconds as minutes or hours.

    >>> clock_text(75.4), clock_text(3725)
    ('1:15', '1:02:05')
    """
    minutes, seconds = divmod(int(time_s), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"


@cache
def _macros(template: str) -> TemplateModule:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("robrain.dashboard.html"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters |= {"cut": cut, "figure": figure, "percent": percent, "degrees": math.degrees}
    environment.filters |= {"clock": clock_text, "span": span_text, "css": css}
    environment.globals |= {
        "NONE": NONE,
        "CHARGER_PLATE": CHARGER_PLATE,
        "CONDITIONS": CONDITIONS,
        "TASK_STATES": TASK_STATES,
        "battery_class": battery_class,
        "mote_class": mote_class,
        "style_of": style_of,
    }
    return environment.get_template(template).module
