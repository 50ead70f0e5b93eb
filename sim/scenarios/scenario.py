"""Scenarios: how scripts and the command line run a team.

from robrain import Scenario

result = Scenario.builtin("depot").replace(robots=3, seed=7).run(until_explored=0.9)
print(f"{result.explored_fraction:.0%} explored in {result.sim_time_s:.0f} s")
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import msgspec
import numpy as np
import zenoh

from robrain.algorithms.exploration.strategies import NO_EXPLORATION
from robrain.algorithms.slam.floor_map import FloorMap, floor_of_cells
from robrain.algorithms.warm_up import warm_up
from robrain.client.team import Team
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.links.exchange import EVERYWHERE
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED
from robrain.protocol.model.rules.mission import Mission
from robrain.protocol.model.rules.rule import Rule
from robrain.protocol.toml_text import toml_of
from robrain.recording.errors import MapError, RecordingError
from robrain.recording.provenance import MAP_YAML_ATTACHMENT, RunSetup
from robrain.recording.reader.floor_file import read_floor
from robrain.sim.errors import ScenarioError
from robrain.sim.faults.fault_spec import FaultSpec, faults_refusal
from robrain.sim.firmware.disturbance import DisturbanceSpec
from robrain.sim.lockstep.lockstep import LockstepRun, LockstepTransport
from robrain.sim.lockstep.pacing import Pacer, StopOnInterrupt
from robrain.sim.lockstep.result import RobotResult, RunResult
from robrain.sim.maps.drawing import FloorDrawing, rasterise
from robrain.sim.maps.floor_plan import FloorPlan, load_map
from robrain.sim.maps.placement import Starts
from robrain.sim.maps.surfaces import SurfaceSpec
from robrain.sim.motes.gateway import check_gateways
from robrain.sim.motes.motes import SensorNetwork
from robrain.sim.points.point_team import POSSIBLE
from robrain.sim.robot.robot_hardware import RobotHardware
from robrain.sim.scenarios import scenario_file
from robrain.sim.scenarios.driving import Progress, drive
from robrain.sim.scenarios.scenario_file import MapTable, MotesTable, ScenarioTable, ScenarioTables, TeamTable
from robrain.sim.traffic.specs import TrafficSpec
from robrain.sim.traffic.traffic import plan_traffic
from robrain.sim.world.chargers import ChargerSpec
from robrain.sim.world.link_spec import LinkSpec, check_alone
from robrain.sim.world.robot_specs import RobotSpec
from robrain.sim.world.scenario_tasks import TaskSpec
from robrain.sim.world.world import Fidelity, World, build_world

ALIKE = ("chargers", "rules", "missions", "faults", "surfaces", "disturbance", "tasks", "links")
"""Fields that a scenario's file has too."""
PLACED = ("robots", "motes", "near", "seed", "hardware", "network", "chargers", "starts", "mote_places")
"""Fields that its robots and motes are placed by."""
OF_WORLD = ("faults", "surfaces", "disturbance", "starts_known", "tasks", "links", "fidelity")
"""Fields that its world has too."""


class Scenario(msgspec.Struct, frozen=True, kw_only=True):
    """A floor, a team and its motes."""

    name: str
    floor: FloorDrawing | Path
    """A drawing, or a ROS map_server file (map.yaml)."""
    robots: int = 4
    motes: int = 0
    near: Point2D | None = None
    """Point around which the robots start; where there is most room if None."""
    starts: Starts = Starts.TOGETHER
    """Together or scattered over the floor."""
    starts_known: bool = True
    """Whether robots know their start poses. If not, only the first robot does: its start defines the arena frame. On a
    known floor no robot does."""
    idle: bool = False
    """Whether the team explores only if a task requests it."""
    known_floor: bool | Path = False
    """Whether the team knows the floor and does not explore it. A path names a map_server file, or the recording of an
    earlier run: the team knows its map."""
    hardware: RobotHardware = RobotHardware()
    """Hardware of each robot."""
    network: SensorNetwork = SensorNetwork()
    """The motes, their radio, and the quantities that they measure."""
    chargers: tuple[ChargerSpec, ...] = ()
    planning: PlanningPolicy = PlanningPolicy()
    """Objective and parameters of the coordinator's plans."""
    rules: tuple[Rule, ...] = ()
    """Tasks that the coordinator makes when a sensor reports an event."""
    missions: tuple[Mission, ...] = ()
    """Sets of tasks that can be started by name."""
    faults: tuple[FaultSpec, ...] = ()
    """Faults and their times."""
    surfaces: SurfaceSpec = SurfaceSpec()
    """Glass and mirrors among the walls."""
    disturbance: DisturbanceSpec = DisturbanceSpec()
    """Late frames and scans, paused agents."""
    tasks: tuple[TaskSpec, ...] = ()
    """Tasks that the scenario requests of the team."""
    traffic: TrafficSpec = TrafficSpec()
    """Doors, moving obstacles and people."""
    mote_places: tuple[tuple[float, float], ...] = ()
    """Places of the first motes, x and y in the arena frame; the others are drawn from the seed."""
    roster: tuple[RobotSpec, ...] = ()
    """Specifications of the first robots, where they differ from `hardware`."""
    about: str = ""
    """Purpose of the scenario, in one sentence."""
    links: LinkSpec | None = None
    """The radio between robots and coordinator; None if every component receives all messages."""
    fidelity: Fidelity = Fidelity.FULL
    """Level of detail of simulated robots."""
    added: dict[str, Any] = {}
    """Tables of other distributions, by name."""
    seed: int = 1
    until_explored: float = 0.98
    time_limit_s: float = 900.0
    toml: str = ""
    """TOML text that the scenario was read from."""

    def __post_init__(self) -> None:
        try:
            msgspec.convert(self.document(), scenario_file.tables_type())
        except ValueError as error:
            raise ScenarioError(f"{self.name}: {error}") from error

    @classmethod
    def builtin(cls, name: str) -> Self:
        """A scenario that comes with robrain, such as `depot` (ScenarioError if there is none of that name)."""
        return cls._from_tables(*scenario_file.read_builtin(name), base=scenario_file.builtin_folder())

    @classmethod
    def from_file(cls, path: Path | str) -> Self:
        """A scenario TOML (ScenarioError naming file and key if it is wrong)."""
        path = Path(path)
        return cls._from_tables(*scenario_file.read_scenario_file(path), base=path.parent)

    @classmethod
    def from_toml(cls, text: str, where: str = "scenario", *, base: Path | str = ".") -> Self:
        """A scenario from the text of a scenario TOML.

        Args:
            text: the TOML.
            where: name of the text in errors.
            base: folder to which `[map] file` is relative.

        Raises:
            ScenarioError: naming `where`, key and expected value.

        """
        return cls._from_tables(scenario_file.parse_scenario(text, where), text, base=Path(base))

    @classmethod
    def from_map(cls, path: Path | str, *, robots: int = 4, motes: int = 0) -> Self:
        """A team on a floor in the ROS map_server format (map.yaml)."""
        path = Path(path)
        return cls(name=path.stem, floor=path, robots=robots, motes=motes)

    @classmethod
    def _from_tables(cls, tables: ScenarioTables, toml: str, *, base: Path) -> Self:
        floor = tables.floor if tables.floor is not None else base / tables.map.file if tables.map else None
        assert floor is not None  # ScenarioTables has checked it
        return cls(
            **msgspec.structs.asdict(tables.scenario),
            **{name: getattr(tables, name) for name in (*ALIKE, "traffic", "network", "added")},
            floor=floor,
            robots=tables.robot_count,
            roster=tables.robots,
            motes=max(tables.motes.count, len(tables.motes.places_m)),
            mote_places=tables.motes.places_m,
            near=Point2D(*tables.team.near_m) if tables.team.near_m is not None else None,
            starts=tables.team.starts,
            starts_known=tables.team.starts_known,
            idle=tables.team.idle,
            known_floor=base / known if isinstance(known := tables.team.known_floor, str) else known,
            hardware=tables.robot,
            planning=tables.planning.with_files_of(base),
            toml=toml,
        )

    def to_toml(self) -> str:
        """The scenario as a scenario file with every key; a floor from a map file is named `map.yaml` in it."""
        return toml_of(self.document(Path(MAP_YAML_ATTACHMENT)))

    def document(self, map_file: Path | None = None) -> dict[str, Any]:
        """The tables of a scenario file with every key, as plain values; None stands for an absent key.

        Args:
            map_file: names the floor if it is from a map file; None: its absolute path.

        """
        known_floor = str(known.resolve()) if isinstance(known := self.known_floor, Path) else known
        near_m = (self.near.x_m, self.near.y_m) if self.near is not None else None
        tables = scenario_file.tables_type()(
            **{name: getattr(self, name) for name in ALIKE},
            scenario=ScenarioTable(
                self.name, self.about, self.seed, self.until_explored, self.time_limit_s, self.fidelity
            ),
            floor=None if isinstance(self.floor, Path) else self.floor,
            map=MapTable(str(map_file or self.floor.resolve())) if isinstance(self.floor, Path) else None,
            team=TeamTable(self.robots, near_m, self.starts, self.starts_known, self.idle, known_floor),
            motes=MotesTable(
                count=self.motes,
                places_m=self.mote_places[: self.motes],
                **msgspec.structs.asdict(self.network.motes),
            ),
            radio=self.network.radio,
            field=self.network.field,
            robot=self.hardware,
            planning=self.planning,
            robots=self.roster,
            **msgspec.structs.asdict(self.traffic),
            **self.added,
        )
        return scenario_file.scenario_document(tables)

    def replace(self, **changes: Any) -> Self:
        """The same scenario with some fields changed: `scenario.replace(robots=8, seed=2)`."""
        try:
            if "fidelity" in changes:
                changes["fidelity"] = Fidelity(changes["fidelity"])
            return msgspec.structs.replace(self, **changes)
        except ValueError as error:
            raise ScenarioError(f"{self.name}: fidelity: expected one of {', '.join(Fidelity)}: {error}") from error
        except TypeError as error:
            known = ", ".join(self.__struct_fields__)
            raise ScenarioError(f"{self.name}: {error}; the fields of a scenario are {known}") from error

    @property
    def policy(self) -> PlanningPolicy:
        """`planning`, without exploration if the team is idle."""
        return msgspec.structs.replace(self.planning, exploration=NO_EXPLORATION) if self.idle else self.planning

    def plan(self) -> FloorPlan:
        """The floor (ScenarioError naming file and key if it cannot be read)."""
        try:
            return load_map(self.floor) if isinstance(self.floor, Path) else rasterise(self.floor, self.name)
        except MapError as error:
            raise ScenarioError(str(error)) from error

    def _floor(self, plan: FloorPlan) -> FloorMap | None:
        """The floor as the team knows it (MapError, RecordingError)."""
        if isinstance(self.known_floor, Path):
            return read_floor(self.known_floor)
        return floor_of_cells(plan.geometry, np.where(plan.occupied, OCCUPIED, FREE)) if self.known_floor else None

    def world(self) -> World:
        """The floor with robots and motes in their places (ScenarioError if they do not fit)."""
        if self.fidelity is Fidelity.POINTS and (refused := {fault.kind for fault in self.faults} - POSSIBLE):
            raise ScenarioError(f'{self.name}: faults: expected no {min(refused)} with fidelity "points"')
        try:
            plan = self.plan()
            floor = self._floor(plan)
            world = build_world(plan, specs=self.roster, **{name: getattr(self, name) for name in PLACED})
            discs = [robot.disc for robot in world.robots]
            has_traffic = self.traffic.is_on and self.fidelity is Fidelity.FULL
            traffic = plan_traffic(self.traffic, plan, discs, self.seed) if has_traffic else None
        except (MapError, RecordingError) as error:
            raise ScenarioError(str(error)) from error
        robots, gateways = [robot.name for robot in world.robots], self.network.motes.gateways
        check_gateways(gateways, robots, world.motes, self.name)
        if self.links is not None:
            self.links.check_names(robots, self.name, gateways)
        if reason := faults_refusal(self.faults, robots):
            raise ScenarioError(f"{self.name}: faults: {reason}")
        radius_m = self.hardware.radius_m
        for fault in self.faults:
            if fault.place_m is not None and plan.wall_distance_m(*fault.place_m, radius_m) < radius_m:
                raise ScenarioError(
                    f"{self.name}: faults: expected room for a robot of radius {radius_m:g} m at place_m "
                    f"{fault.place_m[0]:g}, {fault.place_m[1]:g}"
                )
        added = [one for table in self.added.values() for one in (table if isinstance(table, tuple) else (table,))]
        same = {name: getattr(self, name) for name in OF_WORLD}
        return replace(
            world, traffic=traffic, added=tuple(added), floor=floor, idle=self.idle or floor is not None, **same
        )

    def team(
        self,
        *,
        seed: int | None = None,
        record: Path | str | None = None,
        by: str = "script",
        party: str = EVERYWHERE,
    ) -> Team:
        """The scenario's team in lockstep, for a script; close it, or use it in a `with` block.

        Equal seeds and equal calls give equal runs. Time passes only within the methods of `Team` that wait.

        Args:
            seed: of all random numbers; the scenario's own if None.
            record: MCAP file to write.
            by: name of the client in the records.
            party: party whose radio the script uses, with `[links]`: `coordinator`, or a robot's name. By default it is
                in reach of all.

        Raises:
            RobrainError: the scenario cannot be simulated, or a file not opened; the text gives the reason.

        """
        scenario = self if seed is None else self.replace(seed=seed)
        world = scenario.world()
        warm_up()
        return Team(LockstepTransport(scenario.open(world, record=record, is_script=True), party=party), by=by)

    def run(
        self,
        *,
        until_explored: float | None = None,
        time_limit_s: float | None = None,
        speed: float = 0.0,
        record: Path | str | None = None,
        listen: str | None = None,
        session: zenoh.Session | None = None,
        on_progress: Callable[[Progress], None] | None = None,
        on_open: Callable[[list[str]], None] | None = None,
        before_set_up: Callable[[World], None] | None = None,
        before_start: Callable[[LockstepRun], None] | None = None,
    ) -> RunResult:
        """Run the scenario in lockstep, to its end or to Ctrl-C.

        Args:
            until_explored: stop when this share of the reachable floor is known; the scenario's own if None.
            time_limit_s: stop after this much simulated time; the scenario's own if None.
            speed: simulated seconds per second; 0 for as fast as possible.
            record: MCAP file to write.
            listen: loopback endpoint on which other processes may join, such as `tcp/127.0.0.1:0`.
            session: an open lockstep session to use in place of a new one; closed with the run.
            on_progress: called with the progress of the run.
            on_open: called with the endpoints on which other processes may join, before the first tick.
            before_set_up: called with the new world, before the run is set up.
            before_start: called with the run when it is set up, after `on_open` and before the first tick.

        Raises:
            RobrainError: the scenario cannot be run; the text gives the reason.

        """
        until = self.until_explored if until_explored is None else until_explored
        limit_s = self.time_limit_s if time_limit_s is None else time_limit_s
        setup = Pacer(0.0)
        check_alone(self.links, self.name, is_alone=listen is None and session is None)
        world = self.world()
        if before_set_up is not None:
            before_set_up(world)
        with StopOnInterrupt() as interrupt:  # an interrupt during the start would leave resources open
            run = self.replace(until_explored=until, time_limit_s=limit_s).open(
                world, record=record, listen=listen, session=session, should_stop=lambda: interrupt.requested
            )
        try:
            if interrupt.requested:
                raise KeyboardInterrupt
            if on_open is not None:
                on_open(run.listening_at)
            if before_start is not None:
                before_start(run)
            warm_up(only_at_start=True)
            setup_time_s = setup.wall_time_s
            pacer = Pacer(speed)
            ended, curve, milestones = drive(run, until, limit_s, pacer, on_progress)
            wall_time_s = pacer.wall_time_s
            run.arena.accuracy.measure_map()
            truth, left, tasks = run.truth, run.floor_left(), run.arena.tasks.outcomes()
            known_left = run.publish_exploration_left()
        finally:
            summary = run.close()
        assert summary is not None  # the run was built, so it has a recorder
        return RunResult(
            scenario=self.name,
            seed=self.seed,
            robots=len(world.robots),
            motes=len(world.motes),
            ended=ended,
            sim_time_s=round(truth.sim_time_s, 6),
            wall_time_s=round(wall_time_s, 3),
            setup_time_s=round(setup_time_s, 3),
            real_time_factor=round(truth.sim_time_s / max(wall_time_s, 1e-9), 2),
            explored_fraction=truth.explored_fraction,
            floor_left=left,
            exploration_left=known_left,
            map_accuracy=truth.map_accuracy,
            overlap=round(run.overlap(), 3),
            explored_curve=curve,
            explored_percent_s=milestones,
            distance_m=sum(robot.distance_m for robot in truth.robots),
            energy_j=sum(robot.energy_j for robot in truth.robots),
            collisions=sum(robot.collisions for robot in truth.robots),
            wall_overlap_m=max(0.0, run.wall_overlap_m),
            per_robot=[
                RobotResult(
                    name=robot.robot,
                    distance_m=robot.distance_m,
                    energy_j=robot.energy_j,
                    collisions=robot.collisions,
                    pose=robot.pose,
                    pose_accuracy=robot.accuracy,
                    time_use=run.time_use.of(index),
                    idle=run.idle.get(robot.robot),
                )
                for index, robot in enumerate(truth.robots)
            ],
            messages=summary.messages,
            outside_messages=summary.outside,
            mote_readings=run.mote_readings,
            tasks=tasks,
            links=run.links,
            recording=str(summary.path) if summary.path is not None else None,
            digest=summary.digest,
        )

    def open(
        self,
        world: World,
        *,
        record: Path | str | None = None,
        listen: str | None = None,
        session: zenoh.Session | None = None,
        should_stop: Callable[[], bool] = lambda: False,
        is_script: bool = False,
        fork: dict[str, str] | None = None,
    ) -> LockstepRun:
        """Open a run of a world that the scenario has made; its caller ticks and closes it.

        Args:
            world: from `world()`.
            record: MCAP file to write.
            listen: loopback endpoint on which other processes may join.
            session: an open lockstep session to use in place of a new one; closed with the run.
            should_stop: polled before each robot is set up; True ends the set-up.
            is_script: whether a script runs the team, for the recording.
            fork: the recording's entry on its parent.

        Raises:
            RobrainError: naming the port or file that cannot be opened.
            KeyboardInterrupt: `should_stop` returned True.

        """
        self.planning.import_parts()
        map_yaml = world.map_yaml() if isinstance(self.floor, Path) else ""
        setup = RunSetup(toml=self.to_toml(), map_yaml=map_yaml, is_script=is_script, fork=fork or {})
        return LockstepRun(
            world,
            record=Path(record) if record is not None else None,
            scenario=self.name,
            scenario_toml=self.toml,
            listen=listen,
            session=session,
            planning=self.policy,
            rules=self.rules,
            missions=self.missions,
            should_stop=should_stop,
            setup=setup,
        )


class ListedScenario(msgspec.Struct, frozen=True, kw_only=True):
    """One line of `robrain scenarios`."""

    name: str
    about: str
    """Purpose of the scenario, in one sentence."""
    width_m: float
    """Of its floor, along x."""
    height_m: float
    """Of its floor, along y."""
    robots: int
    motes: int
    tasks: int
    """Number of tasks that the scenario itself submits."""


def listed_scenarios() -> list[ListedScenario]:
    """All of them, sorted by name (ScenarioError if one cannot be read)."""
    return [_listed(Scenario.builtin(name)) for name in scenario_file.builtin_names()]


def _listed(scenario: Scenario) -> ListedScenario:
    width_m, height_m = scenario.plan().size_m
    return ListedScenario(
        name=scenario.name,
        about=scenario.about,
        width_m=round(width_m, 3),
        height_m=round(height_m, 3),
        robots=scenario.robots,
        motes=scenario.motes,
        tasks=len(scenario.tasks),
    )
