"""Pages of the files that robrain reads: scenarios, robot files, manifests and planning policies."""

from collections.abc import Iterator
from types import UnionType
from typing import Any, NamedTuple, Union, get_args, get_origin, get_type_hints

import msgspec

from robrain.agent.host.robot_file import RobotFile
from robrain.agent.manifest import ManifestTables
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.deploy.supervision.team_file import TeamFile
from robrain.sim.scenarios.scenario_file import ScenarioTables
from tests.reference_pages.markdown import page
from tests.reference_pages.struct_tables import Struct, struct_table, summary

SCENARIOS = """\
A scenario is a TOML file that describes a floor, a team and its motes: `robrain run FILE.toml`, or `Scenario.from_file`
in a script. `[scenario]` is required, and either `[floor]`, a drawing, or `[map]`, a map in the ROS map_server format.
All other tables are optional. An unknown key is an error that names file, table and key, with those that there are.
Lengths are in metres and angles in radians, in the arena frame. `robrain scenarios` lists the scenarios that come with
robrain; [Choose or write a scenario](../how-to/scenarios.md) shows them.
"""
ROBOT_FILES = """\
`robrain agent ROBOT.toml` runs one robot. Only `[robot] name` is required; `[parameters.PLUGIN]` overrides the
parameters in a plugin's manifest. `robrain arena --robot-files FOLDER` writes a file for each simulated robot.
"""
TEAM_FILES = """\
`robrain up TEAM.toml --host NAME` starts the parts of one machine of a team. `robrain doctor TEAM.toml --host NAME`
finds obstacles to their start. `[robots]` names the robot file of each robot that is not the scenario's:
`r1 = "robots/r1.toml"`, relative to the team file. At least one `[[hosts]]` is required. [Start, watch and diagnose a
team](../how-to/up.md) shows how the keys work together.
"""
MANIFESTS = """\
A manifest is the TOML file beside a plugin's class; the file's name is the plugin's name. [Write
plugins](../how-to/plugins.md) shows how the keys work together, robrain's own plugins are on the pages
[devices](stock-devices.md), [units](stock-units.md), [skills](stock-skills.md) and [behaviors](stock-behaviors.md).
"""
PLANNING = """\
The table `[planning]` of a scenario, or of a file given to `robrain coordinator --planning FILE.toml`. [Tune
planning](../how-to/tune-planning.md) says when to change what, [Planning](../explanation/planning.md) how plans are
made.
"""


def scenarios_page() -> str:
    """The whole of docs/reference/scenarios.md."""
    return page("Scenario files", SCENARIOS, *file_sections(ScenarioTables))


def robot_files_page() -> str:
    """The whole of docs/reference/robot-files.md."""
    return page("Robot files", ROBOT_FILES, *file_sections(RobotFile))


def team_files_page() -> str:
    """The whole of docs/reference/team-files.md."""
    return page("Team files", TEAM_FILES, *file_sections(TeamFile))


def manifests_page() -> str:
    """The whole of docs/reference/manifests.md."""
    return page("Manifests", MANIFESTS, *file_sections(ManifestTables))


def planning_page() -> str:
    """The whole of docs/reference/planning.md."""
    tables = [
        f"## {each.heading} {{#{each.anchor}}}\n\n{summary(each.struct)}\n\n{struct_table(each.struct)}"
        for each in _tables(PlanningPolicy, "planning.")
    ]
    return page("Planning files", PLANNING, struct_table(PlanningPolicy), *tables)


def file_sections(root: Struct) -> list[str]:
    """A section for each table of a file, as they stand in its structs."""
    tables = list(_tables(root))
    links: dict[str, str] = {}
    for each in tables:
        before = f"{links[each.path]} or " if each.path in links else ""
        words = f'`type = "{each.tag}"`' if each.tag and before else each.heading
        links[each.path] = f"{before}[{words}](#{each.anchor})"
    sections = []
    for each in tables:
        keys = {field.encode_name: f"{each.path}.{field.encode_name}" for field in msgspec.structs.fields(each.struct)}
        fields = struct_table(each.struct, {key: links.get(path, "") for key, path in keys.items()})
        about = summary(each.struct)
        if each.struct is PlanningPolicy:
            about, fields = "See [planning files](planning.md).", ""
        sections.append(f"## {each.heading} {{#{each.anchor}}}\n\n{about}\n\n{fields}")
    return sections


class _Table(NamedTuple):
    """A table of a file."""

    path: str
    struct: Struct
    many: bool
    tag: str
    """Value of its key `type`, where tables of several kinds may be there; else empty."""

    @property
    def heading(self) -> str:
        """Its name in brackets, as in the file."""
        name = f"`[[{self.path}]]`" if self.many else f"`[{self.path}]`"
        return f'{name} of `type = "{self.tag}"`' if self.tag else name

    @property
    def anchor(self) -> str:
        """Where links to it go."""
        path = f"{self.path}.{self.tag}" if self.tag else self.path
        return path.replace(".", "-").replace("_", "-")


def _tables(struct: Struct, prefix: str = "") -> Iterator[_Table]:
    """Tables of a file, those within others after them."""
    for field in msgspec.structs.fields(struct):
        structs, many = _structs_of(get_type_hints(struct)[field.name])
        for inner in structs:
            path = f"{prefix}{field.encode_name}"
            tag = inner.__struct_config__.tag if len(structs) > 1 else None
            yield _Table(path, inner, many, str(tag or ""))
            yield from _tables(inner, f"{path}.")


def _structs_of(hint: Any) -> tuple[list[Struct], bool]:
    """The structs of which a field holds one, and whether it holds many."""
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        return [hint], False
    many = get_origin(hint) in (list, tuple)
    if many or get_origin(hint) in (Union, UnionType):
        return [one for inner in get_args(hint) for one in _structs_of(inner)[0]], many
    return [], False
