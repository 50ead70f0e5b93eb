"""A bring-up of a simulated robot, in lockstep, and the people beside it."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec

from robrain import Scenario
from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.robot_file import RobotFile
from robrain.deploy.bringup.bench import Bench, bench_file
from robrain.deploy.bringup.bring_up import BringUp, BringUpOptions, patched
from robrain.deploy.bringup.findings import BringUpOperator, BringUpReport, CheckFinding, FindingKind
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.world.arena import Arena
from robrain.sim.world.robot_specs import RobotSpec, RobotType
from robrain.sim.world.world import TICK_S, World


class Watcher(BringUpOperator):
    """Answers as a function of the question says; notes what it was told to do."""

    def __init__(self, answer: Callable[[str, str], str] = lambda question, default: default) -> None:
        self._answer = answer
        self.told: list[str] = []
        self.asked: list[str] = []
        self.numbers: list[float] = []

    def prepare(self, what: str) -> None:
        self.told.append(what)

    def choose(self, question: str, choices: Mapping[str, str], default: str) -> str:
        self.asked.append(question)
        answer = self._answer(question, default)
        assert answer in choices
        return answer

    def number(self, question: str) -> float:
        self.asked.append(question)
        return self.numbers.pop(0)


class LockstepBench(Bench):
    """See Bench; the arena is moved on with the host."""

    def __init__(self, world: World) -> None:
        self._session = open_lockstep_session()
        self.clock = VirtualClock()
        self._wire = Endpoint(self._session, DEFAULT_TEAM, self.clock, Drive.LOCKSTEP)
        self.arena = Arena(world, self._wire)
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


AIR, FLOOR = BringUpOptions(floor=False), BringUpOptions(air=False)
NO_SQUARES = BringUpOptions(air=False, rounds=0)
YARD = """
[scenario]
name = "yard"

[floor]
size_m = [7.0, 6.0]
blocks = [
    { x_m = 0.0, y_m = 4.6, width_m = 1.2, height_m = 0.6 },
    { x_m = 6.0, y_m = 0.5, width_m = 0.7, height_m = 1.3 },
]

[motes]
count = 0

[team]
robots = 1
"""
"""A floor with room for squares around `PLACE_M`."""
PLACE_M = (3.0, 3.0)
LEFT: dict[str, Any] = {"frame": "LeftEncoder", "signals": ["left_counts"]}
RIGHT: dict[str, Any] = {"frame": "RightEncoder", "signals": ["right_counts"]}
IMU = {"bias_rad_s": 0.05, "noise_rad_s": 0.005}


class BroughtUp:
    """One robot and its file, brought up as often as wanted.

    Args:
        folder: for the file.
        patch: by plugin, what the file says wrongly.
        hardware: what the robot is built like.
        type: of the robot.
        lidar_known: whether the file says how the lidar is mounted.

    """

    def __init__(
        self,
        folder: Path,
        patch: dict[str, dict[str, Any]],
        hardware: dict[str, Any] | None = None,
        type: RobotType = RobotType.TWO_WHEELS,
        *,
        lidar_known: bool = False,
    ) -> None:
        spec = RobotSpec(type=type, hardware=hardware or {}, place_m=PLACE_M)
        self.world: World = Scenario.from_toml(YARD).replace(roster=(spec,), seed=3).world()
        robot_file = self.world.robot_file(self.world.robots[0])
        parameters = dict(robot_file.parameters)
        if "scan" in parameters and not lidar_known:
            parameters["scan"] = {key: value for key, value in parameters["scan"].items() if key != "mount"}
        robot_file = msgspec.structs.replace(robot_file, parameters=patched(parameters, patch))
        self.path = folder / "r1.toml"
        self.path.write_bytes(b"# hers\n" + msgspec.toml.encode(robot_file))
        self.told: list[CheckFinding] = []

    def run(self, wanted: BringUpOptions, operator: BringUpOperator | None = None) -> BringUpReport:
        with LockstepBench(self.world) as bench:
            return BringUp(self.path, bench, operator or BringUpOperator(), self.told.append).run(wanted)


def wrong(report: BringUpReport) -> set[FindingKind]:
    """What was not as it should be."""
    return {finding.found for finding in report.findings if finding.ok is False}


def value(report: BringUpReport, found: FindingKind, name: str) -> float:
    """A figure of the first finding of a kind."""
    return next(finding.values[name] for finding in report.findings if finding.found is found)
