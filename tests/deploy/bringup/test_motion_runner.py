"""Motions of bring-up end by themselves: when their time is over, when nobody asks any more, before an obstacle."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import msgspec
import pytest

from robrain.agent.errors import AccessDenied
from robrain.deploy.bringup.bench import (
    BASE,
    DRIVER,
    DeviceAbsent,
    MotionFailed,
    MotionRunner,
    Rest,
    StopMode,
    Straight,
    TurnOnSpot,
    TurnWheels,
)
from robrain.deploy.bringup.bring_up import BringUp, BringUpOptions
from robrain.deploy.bringup.findings import CheckStep, FindingKind
from robrain.deploy.bringup.wheel_checks import check_bus
from robrain.plugins.device.mocdevice.frame_map import Checksum, SignalFrame, read_dbc
from robrain.protocol.can.zenoh_bus import ZenohBus
from robrain.protocol.keys import DEFAULT_TEAM
from tests.deploy.bringup.brought_up import AIR, BroughtUp, LockstepBench, Watcher, value, wrong
from tests.plugins.unit.bare_driver import BareDriver


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[LockstepBench]:
    robot = BroughtUp(tmp_path, {})
    with LockstepBench(robot.world) as one:
        one.start(robot.world.robot_file(robot.world.robots[0]), with_lidar=True)
        yield one


def wheels(bench: LockstepBench) -> tuple[float, ...]:
    return bench.arena._robots[0].controller.wheel_speeds_rad_s


def runner(bench: LockstepBench) -> Any:
    return bench.host.manager.get(DRIVER).live_plugin()


def test_the_wheels_stop_once_nobody_asks_how_the_motion_stands(bench: LockstepBench) -> None:
    one = runner(bench)
    one.begin(Straight(1.0))
    for _ in range(50):
        bench.pass_time(0.02)
        assert not one.ask()
    assert any(wheels(bench))
    bench.pass_time(1.1)
    assert not any(wheels(bench))
    assert one.failed == "who asked for the motion is gone"


def test_an_interruption_stops_the_wheels_within_300_ms(bench: LockstepBench, monkeypatch: pytest.MonkeyPatch) -> None:
    pass_time, left = bench.pass_time, iter([1.0] * 50)

    def interrupted(seconds: float) -> None:
        pass_time(seconds)
        if next(left, None) is None:
            raise KeyboardInterrupt

    monkeypatch.setattr(bench, "pass_time", interrupted)
    with pytest.raises(KeyboardInterrupt):
        bench.perform(Straight(1.0))
    assert any(wheels(bench))
    pass_time(0.3)
    assert not any(wheels(bench))


def test_closing_the_bench_stops_the_wheels(bench: LockstepBench) -> None:
    runner(bench).begin(TurnWheels((2.0, 2.0), 5.0))
    bench.pass_time(0.16)
    assert any(wheels(bench))
    bench._end_host()
    bench.pass_time(0.04)
    assert not any(wheels(bench))


def test_a_lidar_that_may_not_be_used_is_reported_and_not_left_out(tmp_path: Path) -> None:
    text = '[plugin]\nclass = "robrain.plugins.device.scan.scan:ScanDevice"\nrole = "scan"\n[tag]\nvisibility = []\n'
    (tmp_path / "hidden.toml").write_text(text)
    world = BroughtUp(tmp_path, {}).world
    robot_file = world.robot_file(world.robots[0])
    table = msgspec.structs.replace(robot_file.robot, places=[str(tmp_path)], roles={"scan": "hidden"})
    with LockstepBench(world) as bench:
        bench.start(msgspec.structs.replace(robot_file, robot=table), with_lidar=True)
        with pytest.raises(DeviceAbsent, match="driver is not in the visibility of"):
            bench.perform(Rest(0.1))


class OnWheels(BareDriver):
    """With the base alone, as the manifest without the lidar requires it."""

    def use(self, name: str, interface: type) -> Any:
        if name != BASE:
            raise AccessDenied(name, "it is not required")
        return super().use(name, interface)


def test_a_runner_that_is_deactivated_stops_the_wheels_itself() -> None:
    devices = OnWheels()
    devices.wheels.wheel_counts = lambda: None  # type: ignore[attr-defined]
    one = MotionRunner(devices, MotionRunner.Parameters())  # type: ignore[arg-type]
    one.init()
    one.activate()
    one.begin(TurnOnSpot(1.0))
    for _ in range(3):
        devices.wait(0.02)
        one.step()
    assert devices.wheels.twist.yaw_rad_s > 0.0
    one.deactivate()
    assert devices.wheels.said[-1] == "stop"
    one.step()
    assert devices.wheels.said[-1] == "stop"


@pytest.mark.slow
def test_a_way_to_a_wall_is_given_up_before_it(bench: LockstepBench) -> None:
    with pytest.raises(MotionFailed, match=r"something is 0\.(27|28|29|30) m from the lidar"):
        bench.perform(Straight(6.0))
    body = bench.arena._robots[0].body
    assert not any(wheels(bench))
    assert body.distance_m > 1.0
    assert bench.arena.collisions == 0


def test_a_robot_whose_wheels_are_blocked_gives_up_in_bounded_time(bench: LockstepBench) -> None:
    bench.arena._robots[0].described._turn = lambda values: None  # type: ignore[union-attr, method-assign]
    began_ns = bench.clock.now_ns()
    with pytest.raises(MotionFailed, match="it has not ended after 8 s"):
        bench.perform(TurnOnSpot(0.6))
    assert bench.clock.now_ns() - began_ns < 10e9


@pytest.mark.slow
def test_wheels_that_turn_on_without_commands_are_named_and_the_robot_is_not_put_on_the_floor(tmp_path: Path) -> None:
    robot, person = BroughtUp(tmp_path, {}), Watcher()
    seen: list[float] = []

    class Endless(LockstepBench):
        def __init__(self, world: Any) -> None:
            super().__init__(world)
            self.arena._robots[0].controller._watchdog_ticks = 1 << 40

    with Endless(robot.world) as bench:
        report = BringUp(robot.path, bench, person, robot.told.append).run(BringUpOptions())
        seen += wheels(bench)
    assert wrong(report) == {FindingKind.NO_WATCHDOG}
    assert report.findings[-1].step is CheckStep.WATCHDOG
    assert len(person.told) == 1
    assert not any(seen)


@pytest.mark.slow
def test_a_halt_is_timed_by_the_wheels_and_the_host_goes_on_afterwards(tmp_path: Path) -> None:
    report = BroughtUp(tmp_path, {}).run(AIR)
    assert value(report, FindingKind.RIGHT, "rate_hz") > 0.0
    (halted,) = [finding for finding in report.findings if finding.step is CheckStep.HALT]
    assert 0.0 <= halted.values["stopped_after_s"] < 0.1
    (silent,) = [finding for finding in report.findings if finding.step is CheckStep.WATCHDOG]
    assert 0.15 < silent.values["stopped_after_s"] < 0.3


def test_another_program_that_drives_the_base_is_noticed(bench: LockstepBench) -> None:
    frame = SignalFrame(
        read_dbc("two_wheels").get_message_by_name("DriveCommand"), ("left_rpm", "right_rpm"), "", Checksum.NONE
    )
    other = ZenohBus("r1/can0", session=bench._session, team=DEFAULT_TEAM, direct=True, now_ns=bench.clock.now_ns)
    pass_time = bench.pass_time

    def driven_by_another(seconds: float) -> None:
        other.send(can.Message(arbitration_id=frame.arbitration_id, data=frame.encode(0, 20, 20), is_extended_id=False))
        pass_time(seconds)

    bench.pass_time = driven_by_another  # type: ignore[method-assign]
    found = {finding.found: finding for finding in check_bus(bench)}
    other.shutdown()
    assert found.keys() == {FindingKind.MOVES_BY_ITSELF, FindingKind.FOREIGN_FRAMES}
    assert found[FindingKind.MOVES_BY_ITSELF].stops
    assert found[FindingKind.FOREIGN_FRAMES].values["foreign"] > 50


def test_a_lidar_that_falls_silent_ends_a_way(bench: LockstepBench) -> None:
    bench.arena._robots[0].scan_phase = -1
    bench.pass_time(0.5)
    with pytest.raises(MotionFailed, match="no turn of the lidar for 1 s"):
        bench.perform(Straight(0.5))


def test_wheels_that_turn_on_in_silence_are_stopped_at_the_end_of_the_motion(bench: LockstepBench) -> None:
    bench.arena._robots[0].controller._watchdog_ticks = 1 << 40
    record = bench.perform(TurnWheels((2.0, 2.0), 1.0, StopMode.SILENCE))
    turned = [sample.turns_rad[0] for sample in record.samples if not sample.is_commanded]
    assert turned[-1] - turned[0] > 1.0
    bench.pass_time(0.1)
    assert not any(wheels(bench))
