"""Scenario files: the TOML that describes a floor, a team and its motes."""

from functools import cache
from importlib import resources
from pathlib import Path
from types import GenericAlias
from typing import Annotated, Any, cast

import msgspec
import numpy as np
from msgspec import Meta

from robrain.coordinator.parts.mission_forms import check_files_missions
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.errors import BadToml
from robrain.protocol.file_mistakes import tables_of
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import Positive
from robrain.protocol.model.rules.mission import Mission
from robrain.protocol.model.rules.rule import Rule, check_rules
from robrain.protocol.registry import Registry
from robrain.protocol.toml_text import LARGE, parse_toml, read_toml_text
from robrain.sim.errors import ScenarioError
from robrain.sim.faults.fault_spec import FaultSpec
from robrain.sim.firmware.disturbance import DisturbanceSpec
from robrain.sim.maps.drawing import FloorDrawing
from robrain.sim.maps.placement import Starts
from robrain.sim.maps.surfaces import SurfaceSpec
from robrain.sim.motes.field import FieldSpec
from robrain.sim.motes.mote import MoteSpec
from robrain.sim.motes.motes import SensorNetwork
from robrain.sim.motes.radio import RadioModel
from robrain.sim.robot.robot_hardware import RobotHardware
from robrain.sim.traffic.specs import DoorSpec, MoverSpec, PeopleSpec, TrafficSpec
from robrain.sim.world.chargers import ChargerSpec
from robrain.sim.world.link_spec import LinkSpec
from robrain.sim.world.robot_specs import RobotSpec
from robrain.sim.world.scenario_tasks import TaskSpec, check_tasks
from robrain.sim.world.world import Fidelity

MAX_ROBOTS = 1000
ROBOTS = 4
"""Default of a team, if the file has none."""
MAX_MOTES = 10000
MAX_SEED = (1 << 63) - 1


class ScenarioTable(Checked, frozen=True, forbid_unknown_fields=True):
    """`[scenario]`: name and end of a run."""

    name: str
    """Name in results and recordings."""
    about: str = ""
    """Purpose of the scenario, in one sentence; `robrain scenarios` prints it."""
    seed: Annotated[int, Meta(ge=0, le=MAX_SEED)] = 1
    """Seed of all random numbers."""
    until_explored: Annotated[float, Meta(gt=0, le=1)] = 0.98
    """Share of the reachable floor at which the run ends."""
    time_limit_s: Positive = 900.0
    """Simulated time at which the run ends at the latest."""
    fidelity: Fidelity = Fidelity.FULL
    """Level of detail of simulated robots: `full`, or `points`, which is many times faster."""


class MapTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """`[map]`: a floor from a ROS map_server file."""

    file: str
    """map.yaml, relative to the scenario file."""


class TeamTable(Checked, frozen=True, forbid_unknown_fields=True):
    """`[team]`: the robots and their starts."""

    robots: Annotated[int, Meta(ge=1, le=MAX_ROBOTS)] | None = None
    """Number of robots, named `r1`, `r2` …; as many as there are `[[robots]]` if absent, or 4."""
    near_m: tuple[float, float] | None = None
    """Point around which the robots start; if absent, where there is most room."""
    starts: Starts = Starts.TOGETHER
    """Placement of the robots at the start."""
    starts_known: bool = True
    """Whether robots know their start poses. If not, only the first robot does: its start defines the arena frame. On a
    known floor no robot does."""

    idle: bool = False
    """Whether the team explores only if a task requests it; it is then there for tasks, scripts and manual control."""
    known_floor: bool | str = False
    """Whether the team knows the floor and does not explore it. A path names a map_server file, or the recording of an
    earlier run: the team knows its map. It is relative to the scenario file."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.starts is Starts.SCATTERED and self.near_m is not None:
            raise ValueError("expected either near_m or scattered starts, got both")


class MotesTable(MoteSpec, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[motes]`: number and kind of the sensor motes."""

    count: Annotated[int, Meta(ge=0, le=MAX_MOTES)] = 0
    """Number of motes, named `m1`, `m2` …; at least as many as there are `places_m`."""
    places_m: tuple[tuple[float, float], ...] = ()
    """Places of the first motes; the others' are drawn from the seed."""


class ScenarioTables(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The whole file: either `[floor]`, a drawing, or `[map]`, a map_server file; `[robot]` describes all robots."""

    scenario: ScenarioTable
    floor: FloorDrawing | None = None
    map: MapTable | None = None
    team: TeamTable = TeamTable()
    motes: MotesTable = MotesTable()
    radio: RadioModel = RadioModel()
    field: FieldSpec = FieldSpec()
    robot: RobotHardware = RobotHardware()
    chargers: tuple[ChargerSpec, ...] = ()
    planning: PlanningPolicy = PlanningPolicy()
    rules: tuple[Rule, ...] = ()
    missions: tuple[Mission, ...] = ()
    faults: tuple[FaultSpec, ...] = ()
    surfaces: SurfaceSpec = SurfaceSpec()
    disturbance: DisturbanceSpec = DisturbanceSpec()
    tasks: tuple[TaskSpec, ...] = ()
    robots: tuple[RobotSpec, ...] = ()
    doors: tuple[DoorSpec, ...] = ()
    movers: tuple[MoverSpec, ...] = ()
    people: tuple[PeopleSpec, ...] = ()
    links: LinkSpec | None = None

    def __post_init__(self) -> None:
        if (self.floor is None) == (self.map is None):
            raise ValueError("expected either [floor] or [map]")
        check_tasks(self.tasks)
        check_files_missions(self.missions)
        check_rules(self.rules, self.missions)

    @property
    def added(self) -> dict[str, Any]:
        """Tables of other distributions that the file has, by name."""
        names = self.__struct_fields__[len(ScenarioTables.__struct_fields__) :]
        return {name: table for name in names if (table := getattr(self, name)) is not None}

    @property
    def robot_count(self) -> int:
        """Number of robots."""
        return self.team.robots or len(self.robots) or ROBOTS

    @property
    def traffic(self) -> TrafficSpec:
        """Content of `[[doors]]`, `[[movers]]` and `[[people]]`."""
        return TrafficSpec(doors=self.doors, movers=self.movers, people=self.people)

    @property
    def network(self) -> SensorNetwork:
        """Content of `[motes]`, `[radio]` and `[field]`."""
        spec = MoteSpec(**{name: getattr(self.motes, name) for name in MoteSpec.__struct_fields__})
        return SensorNetwork(motes=spec, radio=self.radio, field=self.field)


SCENARIO_TABLES: Registry[type[msgspec.Struct]] = Registry(
    "scenario table",
    "robrain.scenario_tables",
    dict.fromkeys(ScenarioTables.__struct_fields__, f"{__name__}:ScenarioTables"),
)
"""Types of tables by name. Robrain's own are the fields of `ScenarioTables`."""


@cache
def tables_type() -> type[ScenarioTables]:
    """`ScenarioTables` with the tables of other distributions: each as `[NAME]`, as `[[NAME]]` or absent."""
    kinds: list[Any] = [item for item in SCENARIO_TABLES.entries().items() if item[1] is not ScenarioTables]
    fields = [(name, kind | GenericAlias(tuple, (kind, ...)) | None, None) for name, kind in kinds]
    return cast("type[ScenarioTables]", msgspec.defstruct("ScenarioTables", fields, bases=(ScenarioTables,)))


def scenario_document(tables: ScenarioTables) -> dict[str, Any]:
    """Scenario tables as dictionaries, lists and plain values; None stands for an absent key."""
    found = msgspec.to_builtins(tables, enc_hook=_plain_number)
    assert isinstance(found, dict)
    return found


def _plain_number(value: Any) -> Any:
    """A number of Python's own for one of NumPy's, which scripts may have calculated with."""
    if isinstance(value, np.generic):
        return value.item()
    raise NotImplementedError(f"a {type(value).__name__} cannot be written to a scenario file")


def builtin_names() -> list[str]:
    """The scenarios that come with robrain."""
    files = resources.files("robrain.sim.scenarios").iterdir()
    return sorted(file.name.removesuffix(".toml") for file in files if file.name.endswith(".toml"))


def builtin_folder() -> Path:
    """Folder of the scenarios that come with robrain; their maps are beside them."""
    return Path(str(resources.files("robrain.sim.scenarios")))


def read_builtin(name: str) -> tuple[ScenarioTables, str]:
    """A scenario that comes with robrain, and its text.

    Raises:
        ScenarioError: there is none of that name.

    """
    if name not in builtin_names():
        raise ScenarioError(f"no scenario {name!r}: built in are {', '.join(builtin_names())}; or give a .toml file")
    text = resources.files("robrain.sim.scenarios").joinpath(f"{name}.toml").read_text(encoding="utf-8")
    return parse_scenario(text, f"{name}.toml"), text


def read_scenario_file(path: Path) -> tuple[ScenarioTables, str]:
    """A scenario file, and its text.

    Raises:
        ScenarioError: naming file, key and expected value.

    """
    try:
        text = read_toml_text(path, LARGE)
    except BadToml as error:
        raise ScenarioError(f"{path}: {error}") from error
    return parse_scenario(text, str(path)), text


def parse_scenario(text: str, where: str) -> ScenarioTables:
    """Scenario tables from TOML text; `where` names the file in errors.

    Raises:
        ScenarioError: naming file, key and expected value.

    """
    try:
        return tables_of(parse_toml(text, LARGE), tables_type())
    except BadToml as error:
        raise ScenarioError(f"{where}: {error}") from error
