from collections.abc import Iterator

import can
import pytest

from robrain.protocol.can.frames import codec
from robrain.protocol.can.zenoh_bus import ZenohBus
from robrain.protocol.model.omni_drive import OmniBase
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.firmware.battery import OPEN_CIRCUIT_V, Battery, open_circuit_v
from robrain.sim.firmware.battery_manager import BatteryManager
from robrain.sim.firmware.motor_controller import MotorController, MotorState
from robrain.sim.firmware.power_model import PowerModel

TICK_S = 0.02
COMMAND = {"wheel_1_rad_s": 1.0, "wheel_2_rad_s": -2.0, "wheel_3_rad_s": 3.5}
SPEEDS = (1.0, -2.0, 3.5)
STANDING = (0.0, 0.0, 0.0)


class Desk:
    """A motor controller on a bus, and a host beside it."""

    def __init__(self, board: can.BusABC, host: can.BusABC) -> None:
        self.board = board
        self.host = host
        self.controller = MotorController(board, OmniBase(), TICK_S)
        self.turns_rad = [0.0, 0.0, 0.0]

    def command(self) -> None:
        self.host.send(codec("WheelCommand").pack(0, **COMMAND))

    def stop(self, *, latched: bool) -> None:
        self.host.send(codec("Stop").pack(0, latched=latched))

    def tick(self, count: int = 1) -> None:
        for _ in range(count):
            self.controller.receive()
            self.controller.report(self.turns_rad)

    def heard(self, name: str) -> list[dict[str, float]]:
        frames = iter(lambda: self.host.recv(timeout=0), None)
        return [codec(name).unpack(frame) for frame in frames if frame.arbitration_id == codec(name).arbitration_id]


@pytest.fixture
def desk() -> Iterator[Desk]:
    session = open_lockstep_session()
    board = ZenohBus("r1/can0", session=session, direct=True)
    host = ZenohBus("r1/can0", session=session, direct=True)
    yield Desk(board, host)
    host.shutdown()
    board.shutdown()
    session.close()


def test_wheels_do_what_a_command_says(desk):
    desk.command()
    desk.tick()
    assert desk.controller.wheel_speeds_rad_s == pytest.approx(SPEEDS)
    assert desk.controller.state is MotorState.RUNNING


def test_wheels_stop_200_ms_after_the_last_command(desk):
    desk.command()
    desk.tick(10)
    assert desk.controller.wheel_speeds_rad_s == pytest.approx(SPEEDS)
    desk.tick()
    assert desk.controller.wheel_speeds_rad_s == STANDING
    assert desk.heard("MotorStatus")[-1]["state"] == MotorState.WATCHDOG


def test_every_command_winds_the_watchdog_up_again(desk):
    for _ in range(5):
        desk.command()
        desk.tick(10)
        assert desk.controller.state is MotorState.RUNNING


def test_corrupt_frames_are_counted_and_not_believed(desk):
    for position in range(8):
        frame = codec("WheelCommand").pack(0, **COMMAND)
        frame.data[position] ^= 0x10
        desk.host.send(frame)
    short = codec("WheelCommand").pack(0, **COMMAND)
    desk.host.send(can.Message(arbitration_id=short.arbitration_id, data=short.data[:7], is_extended_id=False))
    desk.tick()
    assert desk.controller.wheel_speeds_rad_s == STANDING
    assert desk.heard("MotorStatus")[-1]["rejected_frames"] == 9


def test_a_corrupt_stop_is_counted_and_does_not_stop(desk):
    desk.command()
    frame = codec("Stop").pack(0, latched=1)
    frame.data[0] ^= 0x02
    desk.host.send(frame)
    desk.tick()
    assert desk.controller.state is MotorState.RUNNING
    assert desk.controller.rejected_frames == 1


def test_frames_of_others_are_ignored(desk):
    desk.host.send(can.Message(arbitration_id=0x123, data=b"anything", is_extended_id=False))
    desk.host.send(can.Message(arbitration_id=codec("WheelCommand").arbitration_id, data=b"x", is_extended_id=True))
    desk.tick()
    assert desk.controller.rejected_frames == 0
    assert desk.controller.state is MotorState.WATCHDOG


def test_a_latched_stop_refuses_commands_until_it_is_released(desk):
    desk.command()
    desk.stop(latched=True)
    desk.command()
    desk.tick()
    assert desk.controller.wheel_speeds_rad_s == STANDING
    assert desk.heard("MotorStatus")[-1]["state"] == MotorState.LATCHED
    desk.stop(latched=False)
    desk.command()
    desk.tick()
    assert desk.controller.wheel_speeds_rad_s == pytest.approx(SPEEDS)


def test_a_plain_stop_lets_the_next_command_drive(desk):
    desk.command()
    desk.stop(latched=False)
    desk.tick()
    assert desk.controller.wheel_speeds_rad_s == STANDING
    desk.command()
    desk.tick()
    assert desk.controller.wheel_speeds_rad_s == pytest.approx(SPEEDS)


def test_wheels_without_power_stand_whatever_is_commanded(desk):
    desk.controller.powered = False
    desk.command()
    desk.tick()
    assert desk.controller.wheel_speeds_rad_s == STANDING


def test_encoders_count_at_50_hz_and_the_status_comes_at_5_hz_and_on_change(desk):
    desk.tick(50)
    frames = list(iter(lambda: desk.host.recv(timeout=0), None))
    ids = [frame.arbitration_id for frame in frames]
    assert ids.count(codec("WheelEncoders").arbitration_id) == 50
    assert ids.count(codec("MotorStatus").arbitration_id) == 5
    desk.tick(3)
    desk.command()
    desk.tick()
    assert [status["state"] for status in desk.heard("MotorStatus")] == [MotorState.WATCHDOG, MotorState.RUNNING]


def test_encoders_wrap_at_65536_in_both_directions(desk):
    per_tick_rad = OmniBase().rad_per_tick
    desk.turns_rad = [65536.5 * per_tick_rad, -0.5 * per_tick_rad, 10.5 * per_tick_rad]
    desk.tick()
    counts = desk.heard("WheelEncoders")[0]
    assert [counts[f"wheel_{wheel}_ticks"] for wheel in (1, 2, 3)] == [0, 65535, 10]


def test_a_battery_delivers_its_energy_and_no_more():
    battery = Battery(1.0)
    delivered_j = 0.0
    while not battery.is_empty:
        battery.draw(20.0, 1.0)
        delivered_j += battery.voltage_v * battery.current_a
    assert battery.used_j == 3600.0
    assert battery.soc == 0.0
    assert 0.97 * 3600 < delivered_j < 3600  # the rest warmed the battery
    assert battery.temperature_c > 22.0


def test_voltage_falls_with_the_charge_and_with_the_load():
    battery = Battery(20.0)
    voltages = []
    for _ in range(160):
        battery.draw(20.0, 20.0)
        voltages.append(battery.voltage_v)
    assert voltages == sorted(voltages, reverse=True)
    loaded_v = battery.voltage_v
    battery.draw(0.0, 1.0)
    assert battery.voltage_v > loaded_v
    assert [open_circuit_v(soc) for soc in (-1.0, 0.0, 1.0, 2.0)] == [OPEN_CIRCUIT_V[0]] * 2 + [OPEN_CIRCUIT_V[-1]] * 2


def test_a_load_beyond_what_the_battery_can_give_does_not_break_it():
    battery = Battery(20.0)
    battery.draw(10_000.0, 0.1)
    assert battery.voltage_v == pytest.approx(OPEN_CIRCUIT_V[-1] / 2)


@pytest.mark.parametrize("capacity_wh", [0.0, -1.0, float("nan"), float("inf")])
def test_a_battery_without_a_capacity_is_refused(capacity_wh):
    with pytest.raises(ValueError, match="expected battery_wh > 0"):
        Battery(capacity_wh)


def test_the_battery_manager_reports_at_5_hz_what_the_motion_costs(desk):
    manager = BatteryManager(desk.board, Battery(20.0), PowerModel(), 4.0, TICK_S)
    for _ in range(50):
        manager.report(0.0, 0.0)
    standing = desk.heard("BatteryStatus")
    for _ in range(50):
        manager.report(0.5, 0.0)
    moving = desk.heard("BatteryStatus")
    assert len(standing) == len(moving) == 5
    assert standing[-1]["voltage_v"] * standing[-1]["current_a"] == pytest.approx(8.0, rel=1e-2)
    assert moving[-1]["voltage_v"] * moving[-1]["current_a"] == pytest.approx(8.0 + 0.3 + 7.5 * 0.5, rel=1e-2)
    # Half a square of 0.5 m/s for 4 kg over 60 %, within 0.2 s.
    assert moving[0]["voltage_v"] * moving[0]["current_a"] == pytest.approx(12.05 + 0.5 / 0.6 / 0.2, rel=1e-2)


def test_power_grows_with_speed_and_braking_gives_nothing_back():
    power = PowerModel()
    assert power.motion_w(0.0, 0.0) == 0.0
    assert power.motion_w(-0.4, 0.0) == power.motion_w(0.4, 0.0) > power.motion_w(0.2, 0.0)
    assert power.motion_w(0.0, 1.0) > 0.0
    assert power.acceleration_j(4.0, 0.5, 0.0) == 0.0


@pytest.mark.parametrize("values", [{"idle_w": -1.0}, {"drive_efficiency": 0.0}, {"compute_w": float("nan")}])
def test_a_power_model_that_gives_energy_is_refused(values):
    with pytest.raises(ValueError, match="expected"):
        PowerModel(**values)
