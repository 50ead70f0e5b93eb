"""Bring-up against the simulator in lockstep: minutes of motion in seconds of time."""

from pathlib import Path
from types import TracebackType
from typing import Self

from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.robot_file import RobotFile
from robrain.deploy.bringup.bench import Bench, bench_file
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.world.arena import TICK_S, Arena
from robrain.sim.world.world import World


class LockstepBench(Bench):
    """See Bench; the arena is moved on with the host."""

    def __init__(self, world: World) -> None:
        self._session = open_lockstep_session()
        self.clock = VirtualClock()
        self._wire = Endpoint(self._session, DEFAULT_TEAM, self.clock, Drive.LOCKSTEP)
        self.arena: Arena = world.arena(self._wire)
        self._host: AgentHost | None = None

    def start(self, robot_file: RobotFile, *, with_lidar: bool, with_imu: bool = False) -> None:
        self._end_host()
        own = bench_file(robot_file, Path(), with_lidar=with_lidar, with_imu=with_imu)
        self.host = self._host = AgentHost(own, Path(), self._session, self.clock, Drive.LOCKSTEP)
        self._host.start()
        self.pass_time(0.5)

    def pass_time(self, seconds: float) -> None:
        for _ in range(max(1, round(seconds / TICK_S))):
            self.clock.advance_to(self.clock.now_ns() + to_ns(TICK_S))
            self.arena.step()
            if self._host is not None:
                self._host.step()

    def close(self) -> None:
        self._end_host()
        self.arena.close()
        self._wire.close()
        self._session.close()

    def _end_host(self) -> None:
        host, self._host = self._host, None
        if host is not None:
            host.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()
