"""Runs to be drawn, and what is to be seen in a figure, for tests of the report's figures."""

from array import array
from pathlib import Path
from typing import Any

from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from robrain.recording.reader.contents import RecordingContents
from robrain.recording.reader.reading import RecordingInfo
from robrain.recording.reader.run_data import RobotRun, RunData, TaskRun

NAN = float("nan")


def run_of(duration_s: float = 100.0, name: str = "run", messages: int = 0, **fields: Any) -> RunData:
    path = Path(f"{name}.mcap")
    info = RecordingInfo(path=path, size_bytes=2_000_000, messages=messages, start_ns=0, duration_s=duration_s,
                         counts={}, truncated=False, versions={}, digest="")  # fmt: skip
    contents = RecordingContents(info=info, keys=fields.pop("keys", []), run={}, versions={}, host={}, summary={},
                                 attachments={}, manifests=[])  # fmt: skip
    return RunData(path, contents, duration_s, **fields)


def robot_of(name: str, **columns: list[float]) -> RobotRun:
    length = max(map(len, columns.values()))
    blank = {field: [NAN] * length for field in ("x_m", "y_m", "soc", "soc_sd", "measured_j", "predicted_j")}
    told = {"t_s": [10.0 * k for k in range(length)], **blank, **columns}
    return RobotRun(name, **{field: array("d", values) for field, values in told.items()})  # type: ignore[arg-type]


def robots_of(*robots: RobotRun) -> dict[str, RobotRun]:
    return {robot.name: robot for robot in robots}


def axes_of(figure: Figure) -> Any:
    [axes] = figure.axes
    return axes


def texts(axes: Any) -> list[str]:
    return [text.get_text() for text in axes.texts]


def row_names(axes: Any) -> list[str]:
    return [text.get_text() for text in axes.get_yticklabels()]


def legend_texts(axes: Any) -> list[str]:
    legend = axes.get_legend()
    return [] if legend is None else [text.get_text() for text in legend.get_texts()]


def curve(line: Any) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in zip(line.get_xdata(), line.get_ydata(), strict=True)]


def bars(axes: Any) -> list[tuple[float, float, float, str]]:
    """Beginning, length, middle row and colour of each bar."""
    return [
        (round(bar.get_x(), 6), round(bar.get_width(), 6), round(bar.get_y() + bar.get_height() / 2, 6),
         to_hex(bar.get_facecolor()))
        for bar in axes.patches
    ]  # fmt: skip


def task_of(name: str, state: str = "done", **fields: Any) -> TaskRun:
    return TaskRun(name, "visit", state, **fields)
