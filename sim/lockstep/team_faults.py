"""Faults of processes, of the wire and of the journal's disk in a lockstep run with the whole stack.

Agents and coordinator are separate processes. The plugins of a killed agent publish nothing more, and none of their
frames reaches the wheels. An agent that is started later does not know its robot's pose.
"""

from collections.abc import Callable, Collection
from typing import Any

from robrain.agent.host.agent_host import AgentHost
from robrain.coordinator.coordinator import Coordinator
from robrain.protocol.clock import Clock
from robrain.protocol.links.exchange import Exchange
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.wire.endpoint import Endpoint
from robrain.sim.faults.fault_spec import COORDINATOR, PROCESS, WIRE, FaultKind, FaultMoment, FaultSpec, FaultTimes
from robrain.sim.faults.process import Component, JournalDisk, Process
from robrain.sim.faults.wire_faults import WireFaults
from robrain.sim.world.arena import Arena
from robrain.sim.world.team_radio import TeamRadio
from robrain.sim.world.world import World

BY_HAND = -1
"""Number of a kill that is no fault of the scenario."""


class TeamFaults:
    """The processes of a run, and their faults.

    Args:
        world: of the run.
        clock: the run's clock.
        exchange: of the run.
        wire: faults of the wire, which the exchange's network asks.
        radio: of the run, if it has `[links]`.
        arena: with the robots' hardware.

    """

    def __init__(
        self,
        world: World,
        clock: Clock,
        exchange: Exchange,
        wire: WireFaults,
        radio: TeamRadio | None,
        arena: Arena,
    ) -> None:
        self.wire = wire
        self._exchange = exchange
        self._radio = radio
        self._arena = arena
        faults = [fault for fault in world.faults if not fault.is_plain]
        self.times = FaultTimes(faults, world.seed)
        """Times of the faults."""
        self._waits = any(fault.on is not None for fault in faults)
        self.disk = JournalDisk()
        """Of the coordinator's journal."""
        self.processes: dict[str, Process] = {}
        """By component."""
        self._clock = clock
        self._names = [robot.name for robot in world.robots]
        self._events = Inbox()
        self._accepted: set[str] = set()
        self._at: dict[str, tuple[str, bool]] = {}
        self._docked: dict[str, bool] = {}

    def watch_tasks(self, watcher: Endpoint) -> None:
        """Receive the events of tasks by an endpoint, if a fault waits for one."""
        if self._waits:
            watcher.subscribe(self._events, TASK_EVENT)

    @property
    def coordinator(self) -> Coordinator | None:
        """The one that runs; None while it is dead."""
        found = self.processes[COORDINATOR].component
        return found if isinstance(found, Coordinator) else None

    @property
    def hosts(self) -> list[AgentHost]:
        """The agents that run, in the order of their robots."""
        components = [self.processes[name].component for name in self._names]
        return [component for component in components if isinstance(component, AgentHost)]

    def step(self, now_ns: int, paused: Collection[str]) -> None:
        """Begin and end the faults that are due, and run the steps of all agents, then the coordinator's.

        Args:
            now_ns: time of the run.
            paused: robots whose agents run no step now.

        """
        for number, fault, begins in self.times.due(now_ns):
            self.set(number, fault, begins=begins)
        for name in (*self._names, COORDINATOR):
            if name in paused:
                continue
            process = self.processes[name]
            if process.sound is not None:
                process.sound.step()
            else:
                process.step(now_ns)
        if self._waits:
            self._record_moments(now_ns)

    def kill(self, name: str) -> None:
        """Kill a component that runs, besides the faults."""
        self.processes[name].set(BY_HAND, _killed(name), begins=True)

    def start_again(self, name: str) -> None:
        """Start one that was killed by `kill`, unless a fault keeps it dead."""
        self.processes[name].set(BY_HAND, _killed(name), begins=False)

    def close(self) -> None:
        """End all components."""
        for name in reversed(self._names):
            if name in self.processes:
                self.processes[name].close()

    def add(self, name: str, start: Callable[[Process], Component], end: Callable[[Any], None]) -> None:
        """Start a component as a process; arguments as of `Process`."""
        self.processes[name] = process = Process(name, self._clock, self._exchange, start, end)
        process.start()

    def set(self, number: int, fault: FaultSpec, *, begins: bool) -> None:
        """Have a fault begin or end."""
        if fault.kind in WIRE:
            if begins:
                self.wire.begin(number, fault)
            else:
                self.wire.end(number)
        elif fault.kind in PROCESS:
            process = self.processes[fault.robot]
            process.set(number, fault, begins=begins)
            if self._radio is not None:
                self._radio.set_hung(fault.robot, is_hung=process.is_hanging)
        elif fault.kind is FaultKind.DISK_FULL:
            self.disk.is_full = begins
        else:
            self._arena.set_fault(fault, breaks=begins)

    def _record_moments(self, now_ns: int) -> None:
        for received in self._events.drain():
            event = received.message
            # A task of the coordinator's own is never queued before it is offered.
            if event.task.id not in self._accepted and event.state is TaskState.QUEUED:
                self._accepted.add(event.task.id)
                self.times.record(FaultMoment.TASK_ACCEPTED, COORDINATOR, now_ns)
        for host in self.hosts:
            name, status = host.name, host.desk.facts.task
            if status is not None and self._at.get(name) != (status.id, status.state.ended):
                self._at[name] = (status.id, status.state.ended)
                moment = FaultMoment.TASK_DONE if status.state.ended else FaultMoment.TASK_ASSIGNED
                self.times.record(moment, name, now_ns)
            battery = host.board.battery
            is_docked = battery is not None and battery.charging
            if is_docked and not self._docked.get(name, False):
                self.times.record(FaultMoment.DOCKED, name, now_ns)
            self._docked[name] = is_docked


def _killed(name: str) -> FaultSpec:
    return FaultSpec(robot=name, kind=FaultKind.KILL, at_s=0.0)
