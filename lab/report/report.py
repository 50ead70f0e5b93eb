"""A report on one run or several: one self-contained HTML page, and its figures as SVG, PDF or PNG.

The page has no script and forbids any (Content-Security-Policy); every text out of a recording passes `safe_text`
and is escaped by the template.
"""

import base64
import itertools
import math
import re
import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import jinja2
import msgspec
from matplotlib.figure import Figure

from robrain.lab.report import figures
from robrain.lab.report.figure_style import (
    FORMATS,
    bar,
    draw_groups,
    figure_style,
    label,
    label_rows,
    line_style,
    panels,
    picture,
)
from robrain.lab.report.figures import accuracy_figure
from robrain.lab.report.mean_interval import MeanInterval, mean_interval
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.safe_text import safe_text
from robrain.recording.drawing.labels import natural_key
from robrain.recording.errors import RecordingError
from robrain.recording.reader.run_data import RobotRun, RunData, read_run
from robrain.recording.reader.two_runs import TwoRuns, outcome_of, text_of

COMPARED = ("Duration (s)", "Explored (%)", "Distance (m)", "Tasks done", "Energy (kJ)", "Messages")
"""Totals that the comparison of runs draws."""
SEED_AT_END = re.compile(r"[-_ ]*(?:seed)?[-_ ]*$")
ROWS_MAX = 300
"""Rows of a table in the page."""
SECTIONS_MAX = 6
"""With more runs of several seeds than this, the page compares them and has no section for each."""
VECTOR = "svg"
"""Format of the figures in the page."""


def totals(run: RunData) -> dict[str, float | None]:
    """Figures of a whole run, for the table and for comparison; None for missing data."""
    robots = run.robots.values()
    accuracies = [robot.accuracy for robot in robots if robot.accuracy is not None]
    of_map = run.map_accuracy[-1][1] if run.map_accuracy else None
    return {
        "Duration (s)": run.duration_s,
        "Explored (%)": 100 * run.explored[-1][1] if run.explored else None,
        "Known area (m²)": run.map.known_area_m2 or None,
        "Robots": float(len(run.robots)),
        "Motes received": float(len(run.motes)),
        **_of_motes(run),
        "Distance (m)": _sum(robot.distance_m for robot in robots),
        "Energy (kJ)": _sum(None if robot.energy_j is None else robot.energy_j / 1000 for robot in robots),
        "Collisions": _sum(robot.collisions for robot in robots),
        "Map cells off (%)": None if of_map is None else 100 * of_map.share_off,
        "Walls doubled (m)": None if of_map is None else of_map.doubled_walls_m,
        "Worst position RMSE (m)": max((each.rmse_m for each in accuracies if each.rmse_m is not None), default=None),
        "Silent divergence (s)": _sum(each.silent_divergence_s for each in accuracies),
        "Lidar on the map (%)": _agreement_percent(robots),
        "Tasks done": float(run.count(TaskState.DONE)),
        "Tasks failed": float(run.count(TaskState.FAILED)),
        "Faults": float(sum(happening.lasts for happening in run.happenings)),
        "Messages": float(run.contents.info.messages),
        "File (MB)": run.contents.info.size_bytes / 1e6,
    }


def names_of(compared: Iterable[dict[str, float | None]]) -> list[str]:
    """Names of the figures that any run has, in order."""
    return list(dict.fromkeys(name for each in compared for name in each))


def _of_motes(run: RunData) -> dict[str, float | None]:
    """Figures of the mote field; none if the coordinator did no work for it on its own initiative."""
    field = run.mote_field
    if field is None:
        return {}
    return {
        "Motes dead": float(field.dead),
        "Readings arrived (%)": 100 * field.delivery_ratio,
        "Age of mote data (s)": field.age_s,
        "Covered by motes (%)": 100 * field.coverage,
    }


def _agreement_percent(robots: Iterable[RobotRun]) -> float | None:
    """Least mean share of a robot's beams that agreed with its map; None if no robot reports it."""
    means = [statistics.fmean(known) for robot in robots if (known := list(filter(math.isfinite, robot.agreement)))]
    return 100 * min(means) if means else None


def _sum(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(sum(known)) if known else None


def comparison_figure(runs: list[RunData]) -> Figure | None:
    """Totals of each run: a panel for each figure that any run has, a bar for each run, each from zero."""
    compared = [totals(run) for run in runs]
    shown = [name for name in COMPARED if any(total[name] for total in compared)]
    if not shown:
        return None
    names = [label(run.name) for run in runs]
    figure, all_axes = panels(len(shown), len(runs), max(map(len, names)))
    for axes, name in zip(all_axes, shown, strict=True):
        axes.set_title(name)
        values = [total[name] for total in compared]
        for row, value in enumerate(values):
            if value is not None:
                words = f"{value:,.4g}" if value < 1000 else f"{value:,.0f}"
                bar(axes, row, value, line_style(row)["color"], words)
        axes.set_xlim(0, max(value for value in values if value is not None) * 1.25 + 1e-9)
        axes.grid(visible=False, axis="y")
    label_rows(all_axes[0], names)
    all_axes[0].set_ylim(len(runs) - 0.5, -0.5)
    return figure


@dataclass(frozen=True)
class RunGroup:
    """Runs that differ in their seeds only."""

    name: str
    runs: tuple[RunData, ...]

    def values(self, total: str) -> list[float]:
        """A figure of each run's totals, of the runs that have it."""
        values = (totals(run).get(total) for run in self.runs)
        return [value for value in values if value is not None]

    def mean(self, total: str) -> MeanInterval | None:
        """Mean and interval of a figure; None if no run has it."""
        return mean_interval(self.values(total))


def group_runs(runs: Sequence[RunData]) -> list[RunGroup]:
    """Group the runs by scenario, its file, and numbers of robots and motes, in the order of their first runs.

    A repeated seed, and a recording without scenario or seed, is a separate group.
    """
    found: dict[tuple[object, ...], list[RunData]] = {}
    for place, run in enumerate(runs):
        header = run.contents.run
        key: tuple[object, ...] = (
            header.get("scenario"), run.scenario_toml, header.get("drive"), len(run.robots), len(run.motes)
        )  # fmt: skip
        seeds = {other.contents.run.get("seed") for other in found.get(key, ())}
        if not header.get("scenario") or not header.get("seed") or header["seed"] in seeds:
            key = (*key, place)
        found.setdefault(key, []).append(run)
    return [RunGroup(_name(group), tuple(group)) for group in found.values()]


def has_several_seeds(groups: Sequence[RunGroup]) -> bool:
    """Whether any group has more than one run."""
    return any(len(group.runs) > 1 for group in groups)


def grouped_comparison_figure(groups: Sequence[RunGroup]) -> Figure | None:
    """Totals of the runs of each group with mean and interval: a panel for each total that any run has."""
    shown = {total: [group.values(total) for group in groups] for total in COMPARED}
    shown = {total: values for total, values in shown.items() if any(map(any, values))}
    if not shown:
        return None
    labels = [label(group.name) for group in groups]
    figure, all_axes = panels(len(shown), len(groups), max(map(len, labels)))
    for axes, (total, values) in zip(all_axes, shown.items(), strict=True):
        draw_groups(axes, values, [len(group.runs) for group in groups])
        axes.set_title(total)
    label_rows(all_axes[0], labels)
    return figure


def _name(runs: Sequence[RunData]) -> str:
    """Common part of the files' names before the seed, or else the scenario."""
    if len(runs) == 1:
        return runs[0].name
    letters = zip(*(run.name.rstrip("0123456789") for run in runs), strict=False)
    equal = itertools.takewhile(lambda column: len(set(column)) == 1, letters)
    common = SEED_AT_END.sub("", "".join(column[0] for column in equal))
    return common or f"{runs[0].contents.run['scenario']}, {len(runs[0].robots)} robots"


FIGURES: dict[str, Callable[[RunData], Figure | None]] = {
    "explored": lambda run: figures.explored_figure([(run.name, [run])]),
    "trajectories": figures.trajectory_figure,
    "accuracy": accuracy_figure,
    "tasks": figures.task_figure,
    "energy": figures.energy_figure,
    "battery": figures.battery_figure,
    "motes": figures.mote_figure,
    "faults": figures.happenings_figure,
    "traffic": figures.traffic_figure,
}
"""Name of each figure, and its drawing function; a figure without data is skipped."""


class WrittenReport(msgspec.Struct, frozen=True, kw_only=True):
    """Files that were written."""

    page: Path
    figures: list[Path]


class ReportTable(NamedTuple):
    """A table that opens with a click, or is open. Columns whose names begin with a star hold numbers."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    is_open: bool = False


class RunSection(NamedTuple):
    """Content of the page for one run."""

    heading: str
    lead: str
    totals: dict[str, str]
    positions: ReportTable
    drawn: dict[str, str]
    """Pictures in base64, by the figures' names."""
    missing: list[str]
    """Names of figures without recorded data."""
    tables: list[ReportTable]


class RunComparison(NamedTuple):
    """Content of the page for several runs together."""

    names: list[str]
    rows: dict[str, list[str]]
    """Cells of each total, one for each name."""
    seeds: ReportTable | None
    drawn: dict[str, str]
    sides: ReportTable | None
    """Two runs beside each other."""


class _Pictures:
    """Draws figures in all wanted formats, for files and for the page."""

    def __init__(self, forms: Sequence[str]) -> None:
        self.files: dict[str, bytes] = {}
        """Contents by file name."""
        self._forms = forms

    def add(self, name: str, figure: Figure, prefix: str = "") -> str:
        """Keep a figure; returns it in base64, as the page has it."""
        for form in self._forms:
            self.files[f"{prefix}{name}.{form}"] = picture(figure, form)
        data = self.files.get(f"{prefix}{name}.{VECTOR}") or picture(figure, VECTOR)
        return base64.b64encode(data).decode()


def write_report(
    recordings: Sequence[Path],
    folder: Path,
    on_progress: Callable[[float], None] | None = None,
    *,
    forms: Sequence[str] = (VECTOR,),
) -> WrittenReport:
    """Write `folder/report.html` and a file for each figure; files of an earlier report there are replaced.

    Args:
        recordings: one recording, or several to compare; several seeds are compared by mean and interval.
        folder: made if it is not there.
        on_progress: called with the share that is done, 0 to 1.
        forms: formats of the figures' files: `svg`, `pdf`, `png`.

    Raises:
        RecordingError: a recording cannot be read, a format is unknown, or the folder cannot be written.
    """
    if unknown := [form for form in forms if form not in FORMATS]:
        raise RecordingError(folder, f"expected figures as {', '.join(FORMATS)}; got {unknown[0]!r}")
    show = on_progress or (lambda _share: None)
    steps = len(recordings) + 1
    runs = []
    for done, path in enumerate(recordings):
        # mypy cannot infer a lambda with a default.
        runs.append(read_run(path, lambda share, done=done: show((done + share) / steps)))  # type: ignore[misc]
    pictures = _Pictures(forms)
    several = len(runs) > 1
    groups = group_runs(runs)
    with figure_style():
        comparison = _comparison(runs, groups, pictures) if several else None
        is_long = has_several_seeds(groups) and len(runs) > SECTIONS_MAX
        numbered = [] if is_long else list(enumerate(runs, 1))
        sections = [_run_section(run, number if several else None, pictures) for number, run in numbered]
    page = _page(runs, comparison, sections)
    paths = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, data in pictures.files.items():
            paths.append(folder / name)
            paths[-1].write_bytes(data)
        (folder / "report.html").write_text(page, encoding="utf-8")
    except OSError as error:
        raise RecordingError(folder, f"cannot write to {folder}: {error.strerror or error}") from error
    show(1.0)
    return WrittenReport(page=folder / "report.html", figures=paths)


def _page(runs: Sequence[RunData], comparison: RunComparison | None, sections: Sequence[RunSection]) -> str:
    names = safe_text(", ".join(run.name for run in runs), 200)
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("robrain.lab.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters["harmless"] = safe_text
    return environment.get_template("report.html").render(
        title=f"Run {names}" if len(runs) == 1 else f"{len(runs)} runs: {names}",
        comparison=comparison,
        sections=sections,
        rows_max=ROWS_MAX,
    )


def _run_section(run: RunData, number: int | None, pictures: _Pictures) -> RunSection:
    prefix = "" if number is None else f"run{number}_"
    drawn, missing = {}, []
    for name, draw in FIGURES.items():
        if number is not None and name == "explored":
            continue  # it is in the comparison
        figure = draw(run)
        if figure is None:
            missing.append(name)
        else:
            drawn[name] = pictures.add(name, figure, prefix)
    header = run.contents.run
    words = [f"{name} {header[name]}" for name in ("scenario", "seed", "drive", "team") if header.get(name)]
    words += ["its end is missing"] if run.contents.info.truncated else []
    return RunSection(
        heading="" if number is None else run.name,
        lead="; ".join([run.path.name, *words]),
        totals={name: _number(value) for name, value in totals(run).items()},
        positions=_positions(run),
        drawn=drawn,
        missing=missing,
        tables=[_left(run), _happenings(run), _tasks(run), _origin(run)],
    )


def _comparison(runs: Sequence[RunData], groups: Sequence[RunGroup], pictures: _Pictures) -> RunComparison:
    compared = [totals(run) for run in runs]
    if has_several_seeds(groups):
        names = [f"{group.name} ({len(group.runs)} seeds)" if len(group.runs) > 1 else group.name for group in groups]
        rows = {
            total: [_mean_text(group.mean(total), len(group.runs)) for group in groups] for total in names_of(compared)
        }
        head = ("run", "*seed", *(f"*{total}" for total in COMPARED))
        seeds = ReportTable(
            f"Runs ({len(runs)})",
            head,
            [
                (run.name, run.contents.run.get("seed", "–"), *(_number(each[total]) for total in COMPARED))
                for run, each in zip(runs, compared, strict=True)
            ],
        )
        compared_figure = grouped_comparison_figure(groups)
    else:
        names, seeds = [run.name for run in runs], None
        rows = {total: [_number(each.get(total)) for each in compared] for total in names_of(compared)}
        compared_figure = comparison_figure(list(runs))
    explored_figure = figures.explored_figure([(group.name, group.runs) for group in groups])
    drawn = {"explored": explored_figure, "comparison": compared_figure}
    shown = {name: pictures.add(name, figure) for name, figure in drawn.items() if figure is not None}
    return RunComparison(names, rows, seeds, shown, _two_runs_table(*runs) if len(runs) == 2 else None)


def _mean_text(mean: MeanInterval | None, runs: int) -> str:
    if mean is None:
        return "–"
    few = f" ({mean.n} of {runs})" if mean.n < runs else ""
    if not mean.width:
        return _number(mean.mean) + few
    return mean.words(max(0, 1 - math.floor(math.log10(mean.width / 2)))) + few


def _two_runs_table(one: RunData, two: RunData) -> ReportTable:
    """The table of two runs, as `robrain diff` prints it."""
    rows = TwoRuns(first=outcome_of(one), second=outcome_of(two)).rows
    head = ("of", "what", *(f"*{run.name}" for run in (one, two)), "*difference")
    return ReportTable("Who did what", head, [(row.group, row.name, *text_of(row)) for row in rows], is_open=True)


def _happenings(run: RunData) -> ReportTable:
    head = ("*from (s)", "*well at (s)", "what", "who", "why")
    rows = [
        (
            f"{happening.start_s:.1f}",
            "" if not happening.lasts else "not" if happening.end_s is None else f"{happening.end_s:.1f}",
            happening.kind,
            happening.subject,
            happening.text,
        )
        for happening in run.happenings
    ]
    return ReportTable(f"Faults and recoveries ({len(rows)})", head, rows)


def _left(run: RunData) -> ReportTable:
    """Regions that exploration had not finished at the end; no rows if they were not recorded or there are none."""
    if run.left is None or not run.left.regions:
        return ReportTable("", (), ())
    rows = [
        (
            region.kind.value.replace("_", " "),
            f"{region.place.x_m:.1f}, {region.place.y_m:.1f}",
            f"{region.area_m2:.1f}",
            f"{region.low.x_m:.1f}, {region.low.y_m:.1f} to {region.high.x_m:.1f}, {region.high.y_m:.1f}",
            region.words,
        )
        for region in run.left.regions
    ]
    if run.left.more:
        rows.append((f"{run.left.more} smaller", "", f"{run.left.more_m2:.1f}", "", ""))
    head = ("kind", "x, y (m)", "*area (m²)", "box (m)", "why")
    return ReportTable(f"Left to explore ({len(run.left.regions) + run.left.more})", head, rows, is_open=True)


def _positions(run: RunData) -> ReportTable:
    accuracies = {name: run.robots[name].accuracy for name in sorted(run.robots, key=natural_key)}
    rows = []
    for name, accuracy in accuracies.items():
        if accuracy is None:
            continue
        in_band = None if accuracy.nees_in_band is None else 100 * accuracy.nees_in_band
        numbers = (
            accuracy.rmse_m,
            accuracy.max_error_m,
            None if accuracy.yaw_rmse_rad is None else math.degrees(accuracy.yaw_rmse_rad),
            accuracy.nees,
            accuracy.nees_with_yaw,
            in_band,
            accuracy.lost_s,
            accuracy.silent_divergence_s,
            accuracy.longest_silent_divergence_s,
        )
        rows.append((name, *map(_number, numbers)))
    errors = ("*RMSE (m)", "*largest (m)", "*yaw RMSE (°)", "*NEES x, y", "*with yaw", "*in 95 % (%)")
    head = ("robot", *errors, "*lost (s)", "*silently off (s)", "*longest (s)")
    return ReportTable(f"Positions ({len(rows)})", head, rows, is_open=True)


def _tasks(run: RunData) -> ReportTable:
    times = ("*asked (s)", "*begun (s)", "*ended (s)", "*predicted (J)", "*measured (J)")
    rows = []
    for task in run.tasks.values():
        numbers = (task.queued_s, task.started_s, task.ended_s, task.predicted_j, task.measured_j)
        texts = (task.name, task.kind, task.state.replace("_", " "), task.robot)
        rows.append((*texts, *map(_number, numbers), task.reason))
    return ReportTable(f"Tasks ({len(rows)})", ("task", "kind", "state", "robot", *times, "why"), rows)


def _origin(run: RunData) -> ReportTable:
    contents = run.contents
    values = {**contents.run, **contents.host, **contents.versions, **contents.summary}
    return ReportTable("Where it comes from", ("what", "value"), list(values.items()))


def _number(value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:,.0f}" if abs(value) >= 1000 or float(value).is_integer() else f"{value:.4g}"
