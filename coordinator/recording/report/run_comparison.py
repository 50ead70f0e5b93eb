"""Several runs side by side."""

from matplotlib.figure import Figure

from robrain.coordinator.recording.report.figure_style import label, line_look, new_figure, nothing
from robrain.coordinator.recording.report.run_data import RunData
from robrain.coordinator.recording.report.run_totals import totals

COMPARED = ("Duration (s)", "Explored (%)", "Distance (m)", "Tasks done", "Energy (kJ)", "Messages")
"""In rows of three: the first of a row is always told, as its panel has the names of the runs."""


def comparison_figure(runs: list[RunData]) -> Figure:
    """Totals of each run: a panel for each figure, a bar for each run, each from zero."""
    compared = [totals(run) for run in runs]
    figure = new_figure(9.0, 2 * (1.0 + 0.32 * len(runs)))
    panels = figure.subplots(2, 3, sharey=True).flatten()
    for axes, name in zip(panels, COMPARED, strict=True):
        axes.set_title(name)
        values = [total[name] for total in compared]
        known = [value for value in values if value is not None]
        if not known:
            nothing(axes, "not told")
            continue
        for row, value in enumerate(values):
            if value is not None:
                axes.barh(row, value, color=line_look(row)["color"], height=0.65)
                axes.annotate(f"{value:,.4g}" if value < 1000 else f"{value:,.0f}", (value, row), xytext=(4, 0),
                              textcoords="offset points", va="center", fontsize=8)  # fmt: skip
        axes.set_xlim(0, max(known) * 1.25 + 1e-9)
        axes.grid(visible=False, axis="y")
    panels[0].set_yticks(range(len(runs)), [label(run.name) for run in runs])
    panels[0].set_ylim(len(runs) - 0.5, -0.5)
    return figure
