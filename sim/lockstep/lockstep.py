"""The lockstep drive: arena, robots, coordinator and recorder in one process and one thread, on one session.

Every tick the clock advances, then each component runs its step in a fixed order. A message between components is
delivered before the put returns; so equal seeds give equal runs. Zenoh is used in runs that other processes may join.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import zenoh
from numpy.typing import NDArray

from robrain.agent.consensus.witness import WitnessExtension, WitnessInMemory
from robrain.agent.host.agent_host import AgentHost
from robrain.agent.lifecycle.plugin_folders import entry_point_places
from robrain.agent.plugin import PluginState
from robrain.client.transport import Transport
from robrain.coordinator.coordinator import Coordinator
from robrain.coordinator.parts.exploration import Exploration
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.rules.task_rules import TaskRules
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.gc_pause import GcPause
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.links.exchange import COORDINATOR, EVERYWHERE, Exchange
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.maps.map_messages import ExplorationLeft
from robrain.protocol.messages.motes.mote_messages import MOTE_READING
from robrain.protocol.messages.team import arena_messages
from robrain.protocol.messages.team.arena_messages import ArenaTruth, LinkCounters, OutsideInput, ScriptInput
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import TEXT_MAX, cut
from robrain.protocol.model.rules.mission import Mission
from robrain.protocol.model.rules.rule import Rule
from robrain.protocol.reasons import IdleReason
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import LEASE_MS, listening_at, open_lockstep_session
from robrain.recording.provenance import Provenance, RunSetup
from robrain.recording.writer.recorder import OnRecorded, Recorder, RecordingSummary
from robrain.sim.errors import RunFailed
from robrain.sim.faults.fault_spec import check_faults_alone
from robrain.sim.faults.process import Component, Process
from robrain.sim.faults.wire_faults import WireFaults
from robrain.sim.firmware.disturbance import Disturbance
from robrain.sim.lockstep.team_faults import TeamFaults
from robrain.sim.motes.gateway import gateway_motes
from robrain.sim.world.arena import Arena
from robrain.sim.world.link_spec import LinkSpec, check_alone
from robrain.sim.world.referee import FloorLeft, floor_left, overlap
from robrain.sim.world.team_radio import TeamRadio
from robrain.sim.world.time_use import TimeUseMeter
from robrain.sim.world.world import World, manifest_texts

WATCH_S = 0.2
ANSWERS_AFTER_S = 0.4
"""After a cut, queryables are declared again this much later than tokens (chosen)."""
OUTSIDE_BYTES = 1_048_576
"""Size limit of a payload from outside; the recording drops the rest."""


class LockstepRun:
    """One run, tick by tick. Use `Scenario.run` unless you want access between the ticks.

    Args:
        world: the simulated scenario.
        record: MCAP file to write, or None.
        scenario: name of the scenario, for the recording.
        scenario_toml: its text, for the recording.
        listen: loopback endpoint on which other processes, such as a dashboard, may join; None opens none.
        session: an open lockstep session to use in place of a new one; others may be on it. It is closed with the run.
        planning: objective and settings of the coordinator's planning.
        rules: by which the coordinator makes tasks.
        missions: those that can be started.
        should_stop: polled before each robot is set up; True ends the set-up.
        setup: data that repeats the run, for the recording.
        processes: whether the wire may fail, also in a world without such faults.

    Raises:
        RobrainError: naming the port or file that cannot be opened.
        KeyboardInterrupt: `should_stop` returned True; everything opened so far is closed.

    """

    def __init__(
        self,
        world: World,
        *,
        record: Path | None = None,
        scenario: str = "",
        scenario_toml: str = "",
        listen: str | None = None,
        session: zenoh.Session | None = None,
        planning: PlanningPolicy | None = None,
        rules: Sequence[Rule] = (),
        missions: Sequence[Mission] = (),
        should_stop: Callable[[], bool] = lambda: False,
        setup: RunSetup | None = None,
        processes: bool = False,
    ) -> None:
        self.world = world
        self.clock = VirtualClock()
        self.nothing_left = False
        self.idle: dict[str, IdleReason] = {}
        """Reasons why robots are idle, by name, as last published by the coordinator."""
        self.mote_readings = 0
        self.wall_overlap_m = 0.0
        self.tick_s, self._tick_ns = world.tick_s, to_ns(world.tick_s)
        """Duration of a tick."""
        self._watch_ticks = max(1, round(WATCH_S / self.tick_s))
        self._ticks = 0
        self._endpoints: list[Endpoint] = []
        self._planning = planning
        self._rules, self._missions = rules, missions
        self._should_stop = should_stop
        self._closers: list[Callable[[], object]] = []
        self._summary: RecordingSummary | None = None
        is_alone = session is None and listen is None
        check_alone(world.links, scenario or world.plan.name, is_alone=is_alone)
        self.session = open_lockstep_session(listen) if session is None else session
        self._closers.append(self.session.close)
        self.memories = {robot.name: WitnessInMemory() for robot in world.robots}
        """Answers of robots as witnesses; they outlive the robots' agents."""
        self._wire_faults = WireFaults(world.seed)
        self._radio = None if world.links is None else _radio(world, world.links, self._wire_faults)
        has_processes = processes or any(not fault.is_plain for fault in world.faults)
        if has_processes:
            check_faults_alone(scenario or world.plan.name, is_alone=is_alone)
        if is_alone:
            self._exchange = Exchange(
                is_alone=True,
                network=self._wire_faults if has_processes and self._radio is None else self._radio,
                clock=self.clock,
                lost_after_s=LEASE_MS / 1000 if world.links is None else world.links.lost_after_s,
                answers_after_s=ANSWERS_AFTER_S if world.links is None else 0.0,
            ).serve(self.session)
        else:
            self._exchange = Exchange.of(self.session)
        try:
            self._build(record, scenario, scenario_toml, setup)
        except BaseException:
            self.close()
            raise

    def _build(self, record: Path | None, scenario: str, scenario_toml: str, setup: RunSetup | None) -> None:
        world = self.world
        collector = GcPause()
        self._closers.append(collector.release)
        self._watcher = self._endpoint()
        manifests = manifest_texts(world, DEFAULT_TEAM) if record is not None else {}
        provenance = Provenance(
            scenario, scenario_toml, world.seed, world.map_png(), Drive.LOCKSTEP.value, DEFAULT_TEAM, manifests, setup
        )
        self._recorder = Recorder(self._endpoint(), record, provenance, visual=True)
        self._closers.append(self._close_recorder)
        self._outside = self._watcher.publisher(arena_messages.ARENA_OUTSIDE)
        self._script = self._watcher.publisher(arena_messages.ARENA_SCRIPT)
        self._inbox = Inbox()
        self._watcher.subscribe(self._inbox, COORDINATOR_STATE)
        self._watcher.subscribe(self._inbox, MOTE_READING)
        gateway_wire = None if self._radio is None else self._endpoint
        self.arena = Arena(world, self._endpoint(), gateway_wire)
        if self._radio is not None:
            self._radio.follow(self.arena.bodies, self._watcher)
        self.time_use = TimeUseMeter(self._poses())
        self._closers.append(self.arena.close)
        disturbance = Disturbance(world.disturbance, world.seed)
        drawn = {robot.name: disturbance.steps(index) for index, robot in enumerate(world.robots)}
        self._pauses = {name: pauses for name, pauses in drawn.items() if pauses is not None}
        self._distributions = entry_point_places()
        self._manifests_found: dict[Path, list[Path]] = {}
        self.team_faults = TeamFaults(world, self.clock, self._exchange, self._wire_faults, self._radio, self.arena)
        """Processes of the run and their faults."""
        self.team_faults.watch_tasks(self._watcher)
        self._closers += [lambda: self._coordinator_wire.close(), self.team_faults.close]
        self.team_faults.add(COORDINATOR, self._start_coordinator, self._end_coordinator)
        for number, robot in enumerate(world.robots):
            if self._should_stop():
                raise KeyboardInterrupt
            self.team_faults.add(robot.name, partial(self._start_host, number), self._end_host)
        collector.settle()

    def _start_host(self, number: int, process: Process) -> AgentHost:
        world, name = self.world, process.name
        is_restart = process.starts > 1
        host = AgentHost(
            world.robot_file(world.robots[number], team=self._watcher.team, is_restart=is_restart),
            Path(),
            self.session,
            process.clock,
            Drive.LOCKSTEP,
            seed=world.seed,
            on_outside=self._on_outside,
            has_one_thread=True,
            distributions=self._distributions,
            manifests=self._manifests_found,
            extensions={"witness": partial(WitnessExtension, memory=self.memories[name])},
        )
        host.board.hardware = self.arena.robot(name)
        host.start()
        return host

    def _end_host(self, host: AgentHost) -> None:
        with self.arena.unplugged(host.name):
            host.close()

    def _start_coordinator(self, process: Process) -> Component:
        self._coordinator_wire = wire = Endpoint(
            self.session,
            self._watcher.team,
            process.clock,
            Drive.LOCKSTEP,
            on_outside=self._on_outside,
            party=COORDINATOR,
        )
        journal = self.team_faults.disk.open()
        self.coordinator = Coordinator(
            wire, journal, self._planning, self._rules, missions=self._missions, floor=self.world.floor
        )
        return self.coordinator

    def _end_coordinator(self, coordinator: Coordinator) -> None:
        self.team_faults.disk.pull()
        coordinator.close()
        self._coordinator_wire.close()

    @property
    def hosts(self) -> list[AgentHost]:
        """The agents that run, in the order of their robots."""
        return self.team_faults.hosts

    @property
    def has_coordinator(self) -> bool:
        """Whether the coordinator runs."""
        return self.team_faults.coordinator is not None

    @property
    def sim_time_s(self) -> float:
        """Simulated time so far."""
        return self._ticks * self.tick_s

    @property
    def explored_fraction(self) -> float:
        """Share of the reachable floor that is known in the team's maps."""
        return self.arena.referee.explored_fraction

    @property
    def has_open_alarm(self) -> bool:
        """Whether a task that a rule has made is open."""
        return self.coordinator.part(TaskRules).has_open

    def floor_left(self) -> list[FloorLeft]:
        """Regions of floor that were not seen or cannot be reached, and why."""
        robots = self.world.robots
        starts = [Point2D(robot.start.x_m, robot.start.y_m) for robot in robots]
        radius_m = min((robot.radius_m for robot in robots), default=0.0)
        return floor_left(self.world.plan, starts, radius_m, self.arena.referee)

    def publish_exploration_left(self) -> ExplorationLeft | None:
        """Make the coordinator publish the unexplored regions, and return them; None if none runs or nothing is known.

        It is part of the recording, so it changes the digest: for the end of a run.
        """
        return self.coordinator.part(Exploration).publish_remaining() if self.has_coordinator else None

    @property
    def truth(self) -> ArenaTruth:
        """The world as it is now."""
        return self.arena.truth

    @property
    def listening_at(self) -> list[str]:
        """Endpoints on which other processes can join."""
        return listening_at(self.session)

    @property
    def messages(self) -> int:
        """Messages recorded so far."""
        return self._recorder.messages

    @property
    def outside(self) -> int:
        """Number of messages and queries of other processes with an influence so far; 0 in a repeatable run."""
        return self._recorder.outside

    @property
    def links(self) -> LinkCounters | None:
        """Counters of messages between robots and coordinator so far; None if every component receives all messages."""
        return None if self._radio is None else self._radio.counters

    @property
    def digest(self) -> str:
        """Digest of all that was recorded so far."""
        return self._recorder.digest

    @property
    def faults_are_over(self) -> bool:
        """Whether no fault begins or ends any more, unless a fault still waits for an event."""
        return self.team_faults.times.is_over

    @property
    def lost_by_faults(self) -> int:
        """Messages, requests and replies that faults of the wire have lost."""
        return self._wire_faults.lost

    def follow(self, on_recorded: OnRecorded) -> None:
        """Call a function with the messages that each tick records, and with those at the end."""
        self._recorder.follow(on_recorded)

    def switch_off(self, robot: str) -> None:
        """Switch a robot's computer off: its team loses contact, and its wheels stop for lack of commands.

        Its body stays on the floor, where the others have to go around it.

        Raises:
            KeyError: there is no such robot, or it is off already.

        """
        if all(host.name != robot for host in self.hosts):
            raise KeyError(robot)
        self.team_faults.kill(robot)

    def end_coordinator(self) -> None:
        """Kill the coordinator, which runs: it leaves the wire without a word."""
        self.team_faults.kill(COORDINATOR)

    def begin_coordinator(self) -> None:
        """Start another one, on the journal of the one that was killed."""
        self.team_faults.start_again(COORDINATOR)

    def tick(self) -> None:
        """Move the run on by one tick.

        Raises:
            RunFailed: a replaceable part failed, or a stage of a component's step.

        """
        self._ticks += 1
        self.clock.advance_to(self._ticks * self._tick_ns)
        self.arena.step()
        now_ns = self.clock.now_ns()
        self._exchange.step()
        if self._radio is not None:
            self._radio.publish(now_ns)
        pauses = self._pauses
        self.team_faults.step(now_ns, {name for name in pauses if pauses[name].covers(now_ns)} if pauses else ())
        if self._ticks % self._watch_ticks == 0:
            self._watch()
        for endpoint in self._endpoints:
            if endpoint.has_waiting:
                endpoint.serve()
        self._recorder.step()
        self._end_on_defect()

    def _end_on_defect(self) -> None:
        """Raise RunFailed if a substitute replaced code that failed: the run did not measure the requested code."""
        for process in self.team_faults.processes.values():
            if process.component is not None and process.component.refusals.defect:
                raise RunFailed(self._failed(f"{process.name}: {process.component.refusals.defect}"))
        if self._distributions and not self.world.faults and self._ticks % self._watch_ticks == 0:
            self._end_on_fault()

    def _end_on_fault(self) -> None:
        """The same for plugins of installed distributions, if no other cause makes plugins fault."""
        for host in self.hosts:
            for plugin in host.manager.plugins.values():
                is_foreign = any(plugin.manifest.path.is_relative_to(place) for place, _ in self._distributions)
                if is_foreign and plugin.state is PluginState.FAULTED and plugin.raised.where and not plugin.needs:
                    failed = f"{host.name}: plugin {plugin.name} failed: {plugin.raised.where}: {plugin.state_reason}"
                    raise RunFailed(self._failed(failed))

    def _failed(self, what: str) -> str:
        return f"the run ended at {self.sim_time_s:.2f} s: {what}"

    def record_script(self, key: str, request: bytes) -> None:
        """Record the script's next query."""
        self._script.put(ScriptInput(key=cut(key, TEXT_MAX), payload=request[:OUTSIDE_BYTES]))

    def close(self) -> RecordingSummary | None:
        """Stop everything and finish the recording."""
        while self._closers:
            self._closers.pop()()
        return self._summary

    def _endpoint(self, party: str = EVERYWHERE) -> Endpoint:
        endpoint = Endpoint(
            self.session, DEFAULT_TEAM, self.clock, Drive.LOCKSTEP, on_outside=self._on_outside, party=party
        )
        self._endpoints.append(endpoint)
        self._closers.append(endpoint.close)
        return endpoint

    def overlap(self) -> float:
        """How much floor several robots have seen: `sim/world/referee.py`."""
        return overlap(self.arena.referee.submaps, self.arena.referee.grid.geometry)

    def _close_recorder(self) -> None:
        self._summary = self._recorder.close()

    def _on_outside(self, key: str, payload: bytes) -> None:
        self._outside.put(OutsideInput(key=cut(key, TEXT_MAX), payload=payload[:OUTSIDE_BYTES]))

    def _watch(self) -> None:
        for received in self._inbox.drain():
            if received.topic is MOTE_READING:
                self.mote_readings += 1
            else:
                self.nothing_left = received.message.all_explored
                self.idle = {robot.name: robot.idle for robot in received.message.robots if robot.idle is not None}
        self.time_use.add(self._poses(), self.arena.accuracy.at_task, self._watch_ticks * self.tick_s)
        plan = self.world.plan
        for body in self.arena.bodies:
            clearance_m = plan.clearance_at(body.x_m, body.y_m)
            # A cell's clearance is that of its middle: half a diagonal may be lost on the path from there.
            slack_m = 0.71 * plan.resolution_m
            self.wall_overlap_m = max(self.wall_overlap_m, body.radius_m - clearance_m - slack_m)

    def _poses(self) -> NDArray[np.float64]:
        return np.array([(body.x_m, body.y_m, body.yaw_rad) for body in self.arena.bodies])


def _radio(world: World, links: LinkSpec, faults: WireFaults) -> TeamRadio:
    starts_m = np.array([(robot.start.x_m, robot.start.y_m) for robot in world.robots], dtype=float)
    names = [robot.name for robot in world.robots]
    motes = gateway_motes(world.motes, world.network.motes.gateways)
    fixed = {mote.name: (mote.place.x_m, mote.place.y_m) for mote in motes}
    return TeamRadio(links, world.plan, names, starts_m.reshape(-1, 2), world.seed, fixed, faults)


class LockstepTransport(Transport):
    """Talks to the team of a lockstep run. Equal seeds and equal calls give equal runs.

    Args:
        run: the run, of the default team; closed by `close`.
        is_recorded: whether the queries are recorded, so that the run can be repeated.
        party: party whose radio is used, with `[links]`: a robot's name, `coordinator`, or `EVERYWHERE`, which needs
            none.

    """

    drive = Drive.LOCKSTEP
    team = DEFAULT_TEAM

    def __init__(self, run: LockstepRun, *, is_recorded: bool = True, party: str = EVERYWHERE) -> None:
        self._is_recorded = is_recorded
        self.party = party
        self.run = run
        """Arena, hosts and coordinator, for inspection."""
        self.summary: RecordingSummary | None = None
        """Digest and recording, once the run is closed."""
        self.session = run.session
        self.clock = run.clock

    def elapsed_s(self) -> float:
        """Simulated time so far."""
        return self.run.sim_time_s

    def pass_time(self, seconds: float) -> None:
        """Tick, until at least that much time has passed."""
        for _ in range(max(1, math.ceil(seconds / self.run.tick_s - 1e-6))):
            self.run.tick()

    def open_folder(self, robot: str, folder: Path) -> None:
        """The author of the script may load any path that it names."""
        for host in self.run.hosts:
            if host.name == robot:
                host.open_folder(folder)

    def record_query(self, key: str, request: bytes) -> None:
        """Record a query of the script."""
        if self._is_recorded:
            self.run.record_script(key, request)

    def close(self) -> None:
        """End the run and finish its recording."""
        if self.summary is None:
            self.summary = self.run.close()
