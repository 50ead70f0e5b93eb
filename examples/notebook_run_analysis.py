"""Analyse a recorded run in a notebook: each `# %%` begins a cell (VS Code, PyCharm, Spyder, jupytext).

Without a recording as argument, the script first records a short run of the depot.

    python examples/notebook_run_analysis.py run.mcap
"""

# %% A recording
import sys
import tempfile
from pathlib import Path

import robrain

if len(sys.argv) > 1:
    path = Path(sys.argv[1])
else:
    path = Path(tempfile.mkdtemp(prefix="robrain-")) / "depot.mcap"
    robrain.Scenario.builtin("depot").run(time_limit_s=30, record=path)

run = robrain.load(path)
print(f"{run.info.duration_s:.0f} s, {run.info.messages} messages; topics: {', '.join(run.topics)}")

# %% A pandas table for each topic, with a row for each message
states = run.table("robot_state")
states["speed_m_s"] = states["velocity.forward_m_s"].abs()
print(states.groupby("robot")[["speed_m_s", "battery.soc"]].agg(["mean", "min"]).round(3))

# %% Distance driven by each robot, from its own poses
steps = states.sort_values("t_s").groupby("robot")[["pose.x_m", "pose.y_m"]].diff()
states["step_m"] = (steps["pose.x_m"] ** 2 + steps["pose.y_m"] ** 2) ** 0.5
print(states.groupby("robot")["step_m"].sum().round(1).rename("path_m"))

# %% Typed messages
done = [event for event in run.messages("task_event") if event.message.state == "done"]
for event in done[:3]:
    print(f"{event.t_s:6.1f} s  {event.message.task.id} done by {event.message.robot}")

# %% The team's map half-way and at the end
for t_s in (run.info.duration_s / 2, run.info.duration_s):
    grid = run.map_at(t_s)
    if grid is not None:
        area_m2 = grid.known_count * grid.geometry.resolution_m**2
        print(f"after {t_s:.0f} s: {area_m2:.0f} m² known")

# %% A figure; `robrain report` has more
from matplotlib.figure import Figure  # noqa: E402 - a cell of its own

figure = Figure(figsize=(7, 4), layout="constrained")
axes = figure.add_subplot()
for robot, one in states.groupby("robot"):
    axes.plot(one["t_s"], 100 * one["battery.soc"], label=robot)
axes.set_xlabel("Time (s)")
axes.set_ylabel("State of charge (%)")
axes.legend()
figure.savefig(path.with_suffix(".png"))
print(f"figure: {path.with_suffix('.png')}")
