"""Arguments and options of the commands that simulate a scenario."""

from pathlib import Path
from typing import Annotated

import typer

ScenarioArgument = Annotated[
    str | None, typer.Argument(help="A built-in name (depot), a scenario .toml file, or a map.yaml.")
]
MapOption = Annotated[
    Path | None, typer.Option("--map", help="A map.yaml in the ROS map_server format instead of a scenario.")
]
RobotsOption = Annotated[int | None, typer.Option(help="Number of robots.")]
MotesOption = Annotated[int | None, typer.Option(help="Number of sensor motes.")]
SeedOption = Annotated[int | None, typer.Option(help="Seed of all random numbers.")]
NearOption = Annotated[
    str | None, typer.Option(help="X,Y in metres, around which the robots start; default: as the scenario says.")
]
IdleOption = Annotated[
    bool, typer.Option("--idle", help="The team explores only if a task tells it to: for hands and scripts.")
]
UntilOption = Annotated[str | None, typer.Option(help="Stop when this share is explored, such as explored=0.95.")]
TimeLimitOption = Annotated[float | None, typer.Option(help="Stop after this many simulated seconds.")]
