"""Reads and checks the options of commands."""

from pathlib import Path

import msgspec

from robrain.deploy.command_line.options import point
from robrain.deploy.errors import UsageError
from robrain.protocol.model.geometry import Point2D
from robrain.recording.reader.floor_file import RECORDING
from robrain.sim.maps.placement import Starts
from robrain.sim.scenarios.scenario import Scenario


def choose_scenario(
    name: str | None,
    map_file: Path | None,
    robots: int | None,
    motes: int | None,
    seed: int | None,
    near: str | None = None,
    *,
    known: bool = False,
    idle: bool = False,
    strategy: str | None = None,
    method: str | None = None,
) -> Scenario:
    """Load the scenario of a command line.

    Args:
        name: a built-in name, a scenario TOML, or a ROS map_server file.
        map_file: a ROS map_server file, instead of a name; with both, the map that the team knows.
        robots: overrides the scenario's.
        motes: overrides the scenario's.
        seed: overrides the scenario's.
        near: X,Y, around which the robots start together; overrides the scenario's starts.
        known: whether the team knows the floor, or that map; True overrides the scenario's.
        idle: whether the team explores only if a task requests it; True overrides the scenario's.
        strategy: name of an exploration strategy, or FILE.py:NAME; overrides the scenario's.
        method: name of an allocator, or FILE.py:NAME; overrides the scenario's.

    Raises:
        UsageError, ScenarioError: in one sentence.

    """
    known_floor = map_file if known and map_file is not None else known
    if name is not None and known:
        map_file = None
    if map_file is not None and map_file.suffix == RECORDING:
        raise UsageError(f"--map {map_file}: expected a SCENARIO with --known as well, or a map.yaml")
    if (name is None) == (map_file is None):
        raise UsageError("expected a SCENARIO (a built-in name, a .toml file or a map.yaml), or --map map.yaml")
    if map_file is not None or Path(name or "").suffix in (".yaml", ".yml"):
        scenario = Scenario.from_map(map_file or name or "")
    elif name is not None and (name.endswith(".toml") or "/" in name):
        scenario = Scenario.from_file(name)
    else:
        scenario = Scenario.builtin(name or "")
    changes = {"robots": robots, "motes": motes, "seed": seed}
    for option, value in changes.items():
        lowest = 1 if option == "robots" else 0
        if value is not None and value < lowest:
            raise UsageError(f"--{option} {value}: expected at least {lowest}")
    for option, key, part in (("strategy", "exploration", strategy), ("method", "method", method)):
        if part is not None:
            try:
                policy = msgspec.structs.replace(scenario.planning, **{key: part}).with_files_of(Path())
                policy.import_parts()
            except ValueError as error:
                raise UsageError(f"--{option} {part}: {error}") from error
            scenario = scenario.replace(planning=policy)
    if near is not None:
        scenario = scenario.replace(near=Point2D(*point("--near", near)), starts=Starts.TOGETHER)
    if known:
        scenario = scenario.replace(known_floor=known_floor)
    if idle:
        scenario = scenario.replace(idle=True)
    return scenario.replace(**{option: value for option, value in changes.items() if value is not None})
