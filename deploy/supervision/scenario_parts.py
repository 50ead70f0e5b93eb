"""The parts of a team that a scenario describes: simulated robots, and who coordinates, records and shows them."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec

from robrain.deploy.processes.arena_process import (
    loadable_from_here,
    robot_file_of,
    started_again,
    write_resume,
    write_robot_file,
)
from robrain.deploy.processes.kernels import prepare_kernels
from robrain.deploy.processes.table_files import write_planning, write_rules
from robrain.deploy.supervision.part import ARENA, DASHBOARD, RECORDER, Part
from robrain.deploy.supervision.up import (
    Site,
    agent_part,
    coordinator_parts,
    dashboard_part,
    recorder_part,
    votes_option,
)
from robrain.protocol.wire.endpoint import Drive
from robrain.recording.provenance import Provenance
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.world.world import World, manifest_texts


class WantedParts(NamedTuple):
    """What is started of a scenario on this machine."""

    parts: Sequence[str]
    """Names of stock parts and robots."""
    journal: Path
    record: Path | None
    dashboard_port: Callable[[], int | None]
    on_dashboard: Callable[[str], None]
    """Called with each line that the dashboard prints."""
    on_arena: Callable[[str], None]
    on_recorder: Callable[[str], None]
    robot_files: dict[str, Path]
    """Files of robots that are not the scenario's own."""
    witnesses: Sequence[str] = ()
    """Robots that elect one of two coordinators; none if the coordinator is alone."""
    quiet: bool = False
    """Report nothing while kernels are compiled."""


def scenario_parts(site: Site, scenario: Scenario, words: Sequence[str], wanted: WantedParts) -> list[Part]:
    """The parts in the order of their start.

    Args:
        site: where they are started.
        scenario: whose parts they are.
        words: arguments of the command line that name the same scenario.
        wanted: which of them.

    """
    world = scenario.world()
    world.check_live()
    prepare_kernels(quiet=wanted.quiet)  # once here, instead of in every process at the same time
    parts: list[Part] = []
    if RECORDER in wanted.parts and wanted.record is not None:
        provenance = _write_provenance(site, scenario, world)
        parts.append(recorder_part(site, wanted.record, provenance, wanted.on_recorder))
    if ARENA in wanted.parts:
        parts.append(_arena_part(site, words, wanted.on_arena))
    options = ["--planning", str(write_planning(site.folder / "planning.toml", scenario.policy))]
    if scenario.rules:
        options += ["--rules", str(write_rules(site.folder / "rules.toml", scenario.rules))]
    parts += coordinator_parts(site, wanted.journal, options, wanted.parts, wanted.witnesses)
    for robot in world.robots:
        if robot.name in wanted.parts and robot.name not in wanted.robot_files:
            parts.append(_robot_part(site, world, robot.name, wanted.journal))
    for name, path in wanted.robot_files.items():
        if name in wanted.parts:
            parts.append(agent_part(site, name, path, wanted.journal))
    if DASHBOARD in wanted.parts:
        parts.append(dashboard_part(site, wanted.dashboard_port, wanted.on_dashboard))
    return parts


def _arena_part(site: Site, words: Sequence[str], on_line: Callable[[str], None]) -> Part:
    def arguments(start: int) -> list[str]:
        resume = []
        if start > 1 and site.watch.truth is not None:  # the robots stand where they stood, and do not jump home
            resume = ["--resume", str(write_resume(site.folder / "resume.json", site.watch.truth))]
        return ["arena", *words, *site.common, *resume]

    return Part(ARENA, arguments, is_vital=True, must_start=True, on_line=on_line)


def _robot_part(site: Site, world: World, name: str, journal: Path) -> Part:
    robot = next(robot for robot in world.robots if robot.name == name)
    loadable = loadable_from_here([site.endpoint]) if site.is_private else []

    def arguments(start: int) -> list[str]:
        robot_file = robot_file_of(world, robot, team=site.team, connect=site.endpoint, loadable=loadable)
        if start > 1:
            robot_file = started_again(robot_file, site.watch.last_pose(name))
        return ["agent", str(write_robot_file(robot_file, site.folder)), *votes_option(journal)]

    return Part(name, arguments)


def _write_provenance(site: Site, scenario: Scenario, world: World) -> Path:
    provenance = Provenance(
        scenario.name,
        scenario.toml,
        scenario.seed,
        world.map_png(),
        Drive.LIVE.value,
        site.team,
        manifest_texts(world, site.team),
    )
    path = site.folder / "provenance.json"
    path.write_bytes(msgspec.json.encode(provenance))
    return path
