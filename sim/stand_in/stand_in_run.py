"""A run of the stand-in: the product's coordinator and hosts, robots that are points, and the faults of a script.

One process and one thread by a virtual clock, as the lockstep drive, with a tick of 0.1 s. Real are: coordinator,
journal, planning, offers, leases and epochs; the robot's host, task desk and halt desk; the messages between them.
"""

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import zenoh

from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.agent.witness import WitnessExtension, WitnessInMemory
from robrain.coordinator.coordinator import Coordinator
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.faults.fault_spec import COORDINATOR, WIRE, FaultKind, FaultMoment, FaultSpec
from robrain.sim.faults.fault_times import FaultTimes
from robrain.sim.faults.faulty_exchange import FaultyExchange
from robrain.sim.faults.kept_journal import JournalDisk
from robrain.sim.faults.process import Process
from robrain.sim.stand_in import plugins
from robrain.sim.stand_in.fault_script import FaultScript, PointRobot
from robrain.sim.stand_in.operator import OPERATOR, PointOperator
from robrain.sim.stand_in.plugins.point_base.point_base import PointBase
from robrain.sim.stand_in.point_body import CAPACITY_J, PointBody

TICK_S = 0.1
TICK_NS = to_ns(TICK_S)
PLACE = Path(plugins.__file__).parent
LOAD = ["home", "point_visit", "point_recharge"]
_MANIFESTS: dict[Path, list[Path]] = {}
"""Files of plugins that were found before, by folder."""


@cache
def shared_session() -> zenoh.Session:
    """The session of all runs of this process; nothing passes through it."""
    return open_lockstep_session()


class StandInRun:
    """One run, tick by tick.

    Args:
        script: the team, what is asked of it, and its faults.

    """

    def __init__(self, script: FaultScript) -> None:
        self.script = script
        self.clock = VirtualClock()
        self.exchange = FaultyExchange.on(shared_session(), self.clock, script.seed)
        self.disk = JournalDisk()
        self.memories = {robot.name: WitnessInMemory() for robot in script.robots}
        """What robots have answered as witnesses; it outlives their agents."""
        self.drained: set[str] = set()
        """Robots whose battery a fault has drained."""
        self.wire = self._endpoint()
        """An endpoint that no fault touches."""
        self.times = FaultTimes(script.faults, script.seed)
        self.bodies = {
            robot.name: PointBody(robot.name, robot.place, script.chargers, robot.soc) for robot in script.robots
        }
        self._policy = PlanningPolicy(method=script.method)
        self.processes: dict[str, Process] = {}
        self._add(COORDINATOR, self._start_coordinator)
        for robot in script.robots:
            self._add(robot.name, partial(self._start_host, robot))
        with self.exchange.acting(OPERATOR):
            self.operator = PointOperator(self._endpoint(), script)
        self._accepted = 0
        self._at: dict[str, tuple[str, bool]] = {}
        self._docked = {name: body.docked for name, body in self.bodies.items()}

    @property
    def coordinator(self) -> Coordinator | None:
        """The one that runs; None while it is dead."""
        found = self.processes[COORDINATOR].component
        return found if isinstance(found, Coordinator) else None

    def host(self, robot: str) -> AgentHost | None:
        """The agent of a robot; None while it is dead."""
        found = self.processes[robot].component
        return found if isinstance(found, AgentHost) else None

    @property
    def now_ns(self) -> int:
        """Time since the start."""
        return self.clock.now_ns()

    def tick(self) -> None:
        """Move the run on by 0.1 s."""
        self.clock.advance_to(self.clock.now_ns() + TICK_NS)
        now_ns = self.clock.now_ns()
        for number, fault, begins in self.times.due(now_ns):
            self._set(number, fault, begins=begins)
        self.exchange.step()
        for body in self.bodies.values():
            body.step(TICK_S)
        for name in self.bodies:
            self.processes[name].step(now_ns)
        self.processes[COORDINATOR].step(now_ns)
        with self.exchange.acting(OPERATOR):
            self.operator.step(now_ns)
        self._record_moments(now_ns)

    def close(self) -> None:
        """End what there is."""
        for process in self.processes.values():
            process.close()
        self.wire.close()

    # -- processes ------------------------------------------------------------------------------------------

    def _add(self, name: str, start: Callable[[Process], object]) -> None:
        self.processes[name] = process = Process(name, self.clock, self.exchange, start)
        process.start()

    def _start_coordinator(self, process: Process) -> Coordinator:
        return Coordinator(self._endpoint(process), self.disk.open(), self._policy)

    def _start_host(self, robot: PointRobot, process: Process) -> AgentHost:
        chargers = [{"x_m": place.x_m, "y_m": place.y_m} for place in self.script.chargers]
        host = AgentHost(
            RobotFile(
                robot=RobotTable(robot.name, places=[str(PLACE)], load=LOAD, consensus=self.script.consensus),
                parameters={"home": {"chargers": chargers}},
            ),
            Path(),
            shared_session(),
            process.clock,
            Drive.LOCKSTEP,
            seed=self.script.seed,
            has_one_thread=True,
            distributions=[],
            manifests=_MANIFESTS,
            extensions={"witness": partial(WitnessExtension, memory=self.memories[robot.name])},
        )
        host.start()
        base = host.manager.get("point_base").plugin
        assert isinstance(base, PointBase)
        base.attach(self.bodies[robot.name])
        return host

    def _endpoint(self, process: Process | None = None) -> Endpoint:
        clock = self.clock if process is None else process.clock
        return Endpoint(shared_session(), DEFAULT_TEAM, clock, Drive.LOCKSTEP)

    # -- faults ---------------------------------------------------------------------------------------------

    def _set(self, number: int, fault: FaultSpec, *, begins: bool) -> None:
        if fault.kind in WIRE:
            if begins:
                self.exchange.begin(number, fault)
            else:
                self.exchange.end(number)
        elif fault.kind is FaultKind.DISK_FULL:
            self.disk.is_full = begins
        elif fault.kind is FaultKind.DRAIN:
            assert fault.soc is not None  # FaultSpec has checked it
            body = self.bodies[fault.robot]
            body.energy_j = min(body.energy_j, fault.soc * CAPACITY_J)
            self.drained.add(fault.robot)
        else:
            if fault.robot == COORDINATOR and fault.kind is FaultKind.KILL and begins:
                self.disk.pull()
            self.processes[fault.robot].set(number, fault, begins=begins)

    def _record_moments(self, now_ns: int) -> None:
        accepted = len(self.operator.acknowledged)
        if accepted > self._accepted:
            self._accepted = accepted
            self.times.note(FaultMoment.TASK_ACCEPTED, COORDINATOR, now_ns)
        for name, body in self.bodies.items():
            host = self.host(name)
            status = host.desk.facts.task if host is not None else None
            if status is not None and self._at.get(name) != (status.id, status.state.ended):
                self._at[name] = (status.id, status.state.ended)
                moment = FaultMoment.TASK_DONE if status.state.ended else FaultMoment.TASK_ASSIGNED
                self.times.note(moment, name, now_ns)
            if body.docked and not self._docked[name]:
                self.times.note(FaultMoment.DOCKED, name, now_ns)
            self._docked[name] = body.docked
