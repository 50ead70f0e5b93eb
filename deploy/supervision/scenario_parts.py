"""The parts of a team that a scenario describes: the simulator, simulated robots, and options of the others."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import msgspec

from robrain.deploy.processes.arena_process import (
    loadable_from_here,
    robot_file_of,
    started_again,
    write_resume,
    write_robot_file,
)
from robrain.deploy.processes.kernels import prepare_kernels
from robrain.deploy.processes.table_files import RuleTables, write_planning, write_rules
from robrain.deploy.supervision.part import ARENA, Part
from robrain.deploy.supervision.site import Site, votes_option
from robrain.protocol.wire.endpoint import Drive
from robrain.protocol.wire.session import is_loopback
from robrain.recording.provenance import MAP_ATTACHMENT, Provenance
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.world.world import manifest_texts


class ScenarioParts:
    """Makes the parts that a scenario describes.

    Args:
        site: site of their start.
        scenario: site of the parts.
        quiet: print no report while kernels are compiled.

    """

    def __init__(self, site: Site, scenario: Scenario, *, quiet: bool) -> None:
        self._site, self._scenario, self._world = site, scenario, scenario.world()
        self._world.check_live()
        prepare_kernels(quiet=quiet)  # once here, instead of in every process at the same time

    def coordination(self) -> list[str]:
        """Options of the coordinator."""
        folder, scenario = self._site.folder, self._scenario
        options = ["--planning", str(write_planning(folder / "planning.toml", scenario.policy))]
        if scenario.rules or scenario.missions:
            tables = RuleTables(rules=scenario.rules, missions=scenario.missions)
            options += ["--rules", str(write_rules(folder / "rules.toml", tables))]
        if scenario.known_floor:
            known = scenario.known_floor
            options += ["--floor", str(self._write_floor() if known is True else known)]
        return options

    def _write_floor(self) -> Path:
        """Write the scenario's floor as a map; returns its YAML file."""
        path = self._site.folder / "floor.yaml"
        path.write_text(self._world.map_yaml(), encoding="utf-8")
        path.with_name(MAP_ATTACHMENT).write_bytes(self._world.map_png())
        return path

    def arena(self, words: Sequence[str]) -> Part:
        """The simulator, started with the words of a command line that name the same scenario."""
        site = self._site

        def arguments(start: int) -> list[str]:
            resume = []
            if start > 1 and site.monitor.truth is not None:  # the robots stand where they stood, and do not jump home
                resume = ["--resume", str(write_resume(site.folder / "resume.json", site.monitor.truth))]
            return ["arena", *words, *site.common, *resume]

        return Part(ARENA, arguments, is_vital=True, must_start=True, on_line=partial(site.printed.read, ARENA))

    def robot(self, name: str, journal: Path) -> Part:
        """The agent of a simulated robot."""
        site, world = self._site, self._world
        robot = next(robot for robot in world.robots if robot.name == name)
        loadable = loadable_from_here([site.endpoint]) if is_loopback(site.endpoint) else []

        def arguments(start: int) -> list[str]:
            robot_file = robot_file_of(world, robot, team=site.team, connect=site.endpoint, loadable=loadable)
            if start > 1:
                robot_file = started_again(robot_file, site.monitor.last_pose(name))
            return ["agent", str(write_robot_file(robot_file, site.folder)), *votes_option(journal)]

        return Part(name, arguments)

    def write_provenance(self) -> Path:
        """Write the origin of a recording."""
        scenario, world, team = self._scenario, self._world, self._site.team
        provenance = Provenance(
            scenario.name,
            scenario.toml,
            scenario.seed,
            world.map_png(),
            Drive.LIVE.value,
            team,
            manifest_texts(world, team),
        )
        path = self._site.folder / "provenance.json"
        path.write_bytes(msgspec.json.encode(provenance))
        return path
