"""How a report's figures look: light, legible in print, and told apart by colour-blind eyes."""

import io
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robrain.protocol.safe_text import safe_text
from robrain.recording.drawing.palette import ROBOT_COLORS, css

YELLOW = 5
PRINT_COLORS = tuple("#1b1b1b" if place == YELLOW else css(color) for place, color in enumerate(ROBOT_COLORS))
"""The dashboard's, with black for the yellow that is lost on white: the eight of Okabe and Ito."""
LINE_STYLES = ("-", "--", ":", "-.")
MARKERS = "o^sDv"
INK = "#1f2933"
FAINT = "#9aa5b1"
GOOD, WARN, BAD = "#009e73", "#e69f00", "#d55e00"
NEUTRAL = "#0072b2"
DPI = 110
LEGEND_MAX = 16
"""More lines than this have no legend: nobody could read it."""
STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 10,
    "axes.titlesize": 11,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelcolor": INK,
    "axes.edgecolor": FAINT,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e4e7eb",
    "grid.linewidth": 0.8,
    "axes.axisbelow": True,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "text.parse_math": False,  # a dollar in a robot's name is a dollar
    "lines.linewidth": 1.6,
    "svg.hashsalt": "robrain",  # names in the file are equal each time
    "pdf.fonttype": 42,  # letters stay letters: a reader can search and edit them
}


@contextmanager
def figure_style() -> Iterator[None]:
    """The style, for as long as the block draws and saves."""
    with mpl.rc_context(STYLE), warnings.catch_warnings():
        # A name may hold characters that the font lacks; they are drawn as boxes.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        yield


def new_figure(width_in: float = 9.0, height_in: float = 4.2) -> Figure:
    """An empty figure, not of pyplot: nothing global holds it."""
    return Figure(figsize=(width_in, height_in), dpi=DPI, layout="constrained")


def line_style(index: int) -> dict[str, Any]:
    """Colour and dashes of line number `index`, counted from 0."""
    round_number, place = divmod(index, len(PRINT_COLORS))
    return {"color": PRINT_COLORS[place], "linestyle": LINE_STYLES[round_number % len(LINE_STYLES)]}


def label(text: str) -> str:
    """A name from a recording as a figure may have it."""
    return safe_text(text, 40)


def time_axis(axes: Axes, duration_s: float) -> float:
    """Label the x axis with the unit of time that suits; returns how many seconds one of it has."""
    unit_s, name = (1.0, "s") if duration_s <= 300 else (60.0, "min") if duration_s <= 4 * 3600 else (3600.0, "h")
    axes.set_xlabel(f"Time ({name})")
    axes.set_xlim(0.0, max(duration_s / unit_s, 1e-3))
    return unit_s


def legend(axes: Axes, count: int) -> None:
    """A legend beside the axes, unless it would have too many lines."""
    if 1 < count <= LEGEND_MAX:
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)


FORMATS: Mapping[str, dict[str, Any]] = {
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    "png": {"Software": None},
}
"""Formats of figures, each with the metadata that is left out, because it differs with time and version."""


def picture(figure: Figure, form: str = "svg") -> bytes:
    """The figure in one of `FORMATS`; the same figure gives the same bytes. Call it within `figure_style`."""
    out = io.BytesIO()
    figure.savefig(out, format=form, metadata=FORMATS[form])
    return out.getvalue()


def png(figure: Figure) -> bytes:
    """The figure as a PNG; the same figure gives the same bytes."""
    return picture(figure, "png")
