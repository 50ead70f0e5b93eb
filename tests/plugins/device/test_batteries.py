"""Batteries that are asked: smart batteries, current monitors and those of the kernel, on simulated chips and files."""

import errno
import math
import os
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import can
import cantools
import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robrain.algorithms.energy.battery_report import BatteryReport
from robrain.plugins.device.bm2 import i2c_battery
from robrain.plugins.device.bm2.bm2 import BatteryFrame, BatteryMap, Bm2
from robrain.plugins.device.bm2.i2c_battery import REGISTERS, InaBattery, SmartBattery, SmartBatteryStatus
from robrain.plugins.device.bm2.interface import ASSUMED_C, plausible
from robrain.plugins.device.bm2.polled_battery import BatteryAbsent, PowerSupply
from robrain.plugins.device.mocdevice.frame_map import Checksum
from tests.plugins.device.bare_device import BareDevice
from tests.plugins.device.battery_chips import InaChip, SmartBatteryChip
from tests.plugins.device.i2c_bus import I2cBus

ADDRESS = 0x0B


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch) -> Iterator[I2cBus]:
    wires = I2cBus()
    monkeypatch.setattr(i2c_battery, "SMBus", wires.open)
    yield wires
    assert wires.opened == wires.closed, "each handle on the bus is closed"


@pytest.fixture
def chip(bus: I2cBus) -> SmartBatteryChip:
    bus.chips[ADDRESS] = one = SmartBatteryChip()
    return one


@pytest.fixture
def device(bus: I2cBus) -> Iterator[Any]:
    made: list[BareDevice] = []

    def build(device_class: type, **parameters: Any) -> BareDevice:
        one = BareDevice(device_class, **parameters)
        made.append(one)
        one.it.activate()
        return one

    yield build
    for one in made:
        one.it.deactivate()


def latest(one: BareDevice) -> Any:
    one.step(0.2)
    return one.it.latest()


def step_often(one: BareDevice) -> None:
    for _ in range(8):
        one.step(0.2)


# -- smart batteries --------------------------------------------------------------------------------------------


def test_a_smart_battery_tells_its_measurements_and_its_charge(device: Any, chip: SmartBatteryChip) -> None:
    one = device(SmartBattery)
    chip.voltage_v, chip.current_a, chip.temperature_c, chip.soc, chip.error_percent = 14.321, 1.234, -5.0, 0.63, 8
    found = latest(one)
    assert (found.voltage_v, found.current_a) == (pytest.approx(14.321), pytest.approx(1.234))
    assert found.temperature_c == pytest.approx(-5.0, abs=0.06)
    assert found.report == BatteryReport(soc=0.63, soc_sd=0.04)


def test_alarms_of_a_smart_battery_are_told_by_name(device: Any, chip: SmartBatteryChip) -> None:
    one = device(SmartBattery)
    chip.status, chip.remaining_mah = 0x1000 | 0x0200 | 0x0040 | 0x0007, 123
    one.step()
    assert one.it.status() == SmartBatteryStatus(("over temperature", "remaining capacity low"), 123, 7)


def test_noise_is_noticed_where_packets_have_a_checksum(device: Any, bus: I2cBus, chip: SmartBatteryChip) -> None:
    one = device(SmartBattery, pec=True)
    before = latest(one)
    for bit in range(16):
        bus.flips.append(bit)
        one.step(0.1)
        assert one.it.latest() == before
        latest(one)
        before = one.it.latest()
    counters = one.it.counters()
    assert (counters.failed, counters.last_error) == (16, "Bad message")


NAN = math.nan


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ((12.0, 1.0, 20.0, 0.5), (12.0, 1.0, 20.0, True, 0.5)),
        ((12.0, 1.0, 300.0, 0.5), (12.0, 1.0, 25.0, True, 0.5)),
        ((12.0, 1.0, -273.15, 0.5), (12.0, 1.0, 25.0, True, 0.5)),
        ((12.0, 1.0, NAN, NAN), (12.0, 1.0, 25.0, True, None)),
        ((12.0, 1.0, None, 1.3), (12.0, 1.0, 25.0, True, None)),
        ((12.0, 1e9, 20.0, -0.1), (12.0, 2.0, 20.0, False, None)),
        ((12.0, NAN, 20.0, 0.5), (12.0, 2.0, 20.0, False, 0.5)),
    ],
)
def test_an_implausible_value_costs_that_value(values: Any, expected: Any) -> None:
    found = plausible(*values, assumed_a=2.0, assumed_c=25.0, soc_sd=0.1)
    assert isinstance(found.report, BatteryReport)
    assert (*found[:3], found.report.has_current, found.report.soc) == expected


@given(st.lists(st.integers(0, 0xFFFF), min_size=8, max_size=8))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_whatever_a_battery_answers_is_a_measurement_or_rejected(bus: I2cBus, words: list[int]) -> None:
    bus.chips[ADDRESS] = SmartBatteryChip()
    one = BareDevice(SmartBattery)
    one.it.activate()
    registers = (0x08, 0x09, 0x0A, 0x0C, 0x0D, 0x0F, 0x16, 0x1A)
    bus.chips[ADDRESS] = SimpleNamespace(word=dict(zip(registers, words, strict=True)).__getitem__)
    one.step(0.2)
    counters, found = one.it.counters(), one.it.latest()
    assert (counters.readings, counters.rejected, counters.failed) in ((2, 0, 0), (1, 1, 0))
    assert 0.0 <= (found.report.soc or 0.0) <= 1.0
    assert found.report.soc_sd >= 0.01
    one.it.deactivate()


@pytest.mark.parametrize("is_whole_bus", [False, True])
def test_a_battery_that_stays_away_is_a_fault_that_names_it(
    device: Any, bus: I2cBus, chip: SmartBatteryChip, is_whole_bus: bool
) -> None:
    one = device(SmartBattery, silent_s=1.0)
    latest(one)
    bus.is_there = not is_whole_bus
    bus.chips.clear()
    with pytest.raises(BatteryAbsent, match=r"for 1\.\d s from the smart battery at /dev/i2c-1, address 0x0b: "):
        step_often(one)


# -- current monitors -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", list(REGISTERS))
@pytest.mark.parametrize("current_a", [1.5, -0.75, 0.0])
def test_a_monitor_tells_voltage_and_current(device: Any, bus: I2cBus, kind: str, current_a: float) -> None:
    bus.chips[0x41] = chip = InaChip(is_226=kind == "ina226", shunt_ohm=0.02)
    chip.voltage_v, chip.current_a = 12.6, current_a
    found = latest(device(InaBattery, chip=kind, address=0x41, shunt_ohm=0.02))
    assert found.voltage_v == pytest.approx(12.6, abs=0.003)
    assert found.current_a == pytest.approx(current_a, abs=0.001)
    assert latest(device(InaBattery, chip=kind, address=0x41, shunt_ohm=0.02, current_sign=-1)).current_a == (
        pytest.approx(-current_a, abs=0.001)
    )


@pytest.mark.parametrize(("kind", "averaging"), [("ina219", 0x3FFF), ("ina226", 0x4727)])
def test_a_monitor_that_has_lost_power_is_told_again_how_to_measure(
    device: Any, bus: I2cBus, kind: str, averaging: int
) -> None:
    bus.chips[0x40] = chip = InaChip(is_226=kind == "ina226")
    one = device(InaBattery, chip=kind)
    first = latest(one)
    assert chip.configuration == averaging
    chip.restart()
    assert latest(one) == first
    assert chip.configuration == averaging
    assert latest(one).stamp_ns > first.stamp_ns
    assert one.it.counters().rejected == 1


# -- batteries of the kernel ------------------------------------------------------------------------------------


@pytest.fixture
def supply(tmp_path: Path) -> Any:
    def write(name: str = "BAT0", **values: Any) -> Path:
        folder = tmp_path / name
        folder.mkdir(exist_ok=True)
        for key, value in ({"type": "Battery", "status": "Discharging"} | values).items():
            if value is None:
                (folder / key).unlink(missing_ok=True)
            else:
                (folder / key).write_text(f"{value}\n")
        return tmp_path

    return write


def test_a_battery_of_the_kernel_tells_what_its_files_say(device: Any, supply: Any) -> None:
    folder = supply(voltage_now=12_345_000, current_now=-1_500_000, temp=312, capacity=87, present=1)
    found = latest(device(PowerSupply, folder=str(folder)))
    assert (found.voltage_v, found.current_a) == (pytest.approx(12.345), pytest.approx(1.5))
    assert found.temperature_c == pytest.approx(31.2)
    assert found.report == BatteryReport(soc=0.87, soc_sd=0.05)


@pytest.mark.parametrize(
    ("status", "current_a"), [("Charging", -1.5), ("Discharging", 1.5), ("Full", 0.0), ("Unknown", -1.5)]
)
def test_the_status_tells_the_sign_of_the_current(device: Any, supply: Any, status: str, current_a: float) -> None:
    folder = supply(voltage_now=12_000_000, current_now=1_500_000, status=status)
    assert latest(device(PowerSupply, folder=str(folder))).current_a == pytest.approx(current_a)


@pytest.mark.parametrize("value", ["abc", "999999999999999", "-40000"])
@pytest.mark.parametrize("name", ["capacity", "temp", "current_now"])
def test_a_value_of_the_kernel_that_cannot_be_costs_that_value(device: Any, supply: Any, name: str, value: str) -> None:
    one = device(PowerSupply, folder=str(supply(voltage_now=12_000_000, **{name: value})), current_a=0.04)
    found = latest(one)
    assert (found.voltage_v, abs(found.current_a), found.report.soc) == (12.0, pytest.approx(0.04), None)
    assert one.it.counters().rejected == 0


def test_current_is_power_by_voltage_where_only_that_is_told(device: Any, supply: Any) -> None:
    folder = supply(voltage_now=10_000_000, power_now=25_000_000)
    assert latest(device(PowerSupply, folder=str(folder))).current_a == pytest.approx(2.5)


@pytest.mark.parametrize("name", ["capacity", "voltage_now"])
@pytest.mark.parametrize("code", [errno.ENODATA, errno.EINVAL, errno.EIO])
def test_a_file_of_the_kernel_that_cannot_be_read_is_a_failure_unless_it_has_no_value_now(
    device: Any, supply: Any, monkeypatch: pytest.MonkeyPatch, name: str, code: int
) -> None:
    one = device(PowerSupply, folder=str(supply(voltage_now=12_000_000, capacity=50)))
    before, plain = latest(one), Path.open

    def fail(path: Path, *mode: str) -> Any:
        if path.name == name:
            raise OSError(code, os.strerror(code))
        return plain(path, *mode)

    monkeypatch.setattr(Path, "open", fail)
    found, counters = latest(one), one.it.counters()
    is_failure = code == errno.EIO or name == "voltage_now"
    assert (found == before, counters.failed) == (is_failure, is_failure)
    assert (counters.last_error == "Input/output error") is (code == errno.EIO)
    assert is_failure or found.report.soc is None


@pytest.mark.parametrize("voltage", ["", "abc", "1" * 100, "12.5"])
def test_what_is_no_number_is_rejected(device: Any, supply: Any, voltage: str) -> None:
    one = device(PowerSupply, folder=str(supply(voltage_now=12_000_000)))
    before = latest(one)
    supply(voltage_now=voltage)
    assert latest(one) == before
    assert one.it.counters().rejected == 1


@pytest.mark.slow
def test_a_battery_of_the_kernel_that_is_taken_out_is_a_fault_and_back_when_it_is_in(device: Any, supply: Any) -> None:
    folder = supply(voltage_now=12_000_000, present=1)
    one = device(PowerSupply, folder=str(folder), silent_s=1.0)
    latest(one)
    supply(present=0)
    with pytest.raises(BatteryAbsent, match="no battery is inserted"):
        step_often(one)
    with pytest.raises(BatteryAbsent, match="no battery is inserted"):
        one.it.activate()
    supply(present=1)
    one.it.activate()
    assert latest(one).stamp_ns == one.clock.now_ns()


@pytest.mark.parametrize("name", ["../BAT0", "a/b", "..", "x" * 65])
def test_a_name_that_leaves_the_folder_is_refused(name: str) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"name": name}, PowerSupply.Parameters)


# -- on a robot -------------------------------------------------------------------------------------------------


DBC = """VERSION ""
NS_ :
BS_:
BU_: Pack Host
BO_ 2566834709 Pack1: 8 Pack
 SG_ current : 7|16@0- (10,0) [0|0] "mA" Host
 SG_ voltage : 23|16@0+ (1,0) [0|65535] "mV" Host
 SG_ spare : 39|32@0- (1,0) [0|0] "" Host
BO_ 851 Float: 4 Pack
 SG_ volts : 0|32@1- (1,0) [0|0] "V" Host
BO_ 850 Pack2: 4 Pack
 SG_ soc : 0|8@1+ (0.5,0) [0|127] "%" Host
 SG_ kelvin : 8|16@1+ (0.1,0) [0|0] "K" Host
 SG_ sum : 24|8@1+ (1,0) [0|255] "" Host
SIG_VALTYPE_ 851 volts : 1;
"""
MAP: dict[str, Any] = {
    "frames": (
        BatteryFrame(frame="Pack1", signals={"voltage": "voltage mV", "current": "current mA"}),
        BatteryFrame(frame="Pack2", signals={"soc": "soc %", "kelvin": "temperature K"}),
    ),
    "counter": "",
    "checksum": Checksum.NONE,
    "current_sign": -1,
}


class Pack:
    """A device that hears frames of the file above."""

    def __init__(self, folder: Path, **changes: Any) -> None:
        (folder / "pack.dbc").write_text(DBC)
        self.dbc: Any = cantools.database.load_string(DBC, "dbc")
        wanted = BatteryMap(dbc=str(folder / "pack.dbc"), **(MAP | changes))
        self.device = BareDevice(Bm2, battery=wanted)
        self.device.it.activate()

    def hear(self, name: str, **signals: float) -> Any:
        message = self.dbc.get_message_by_name(name)
        data = message.encode({signal.name: 0 for signal in message.signals} | signals)
        if name == "Pack2":
            data = data[:-1] + bytes((sum(data[:-1]) & 0xFF,))
        self.device.wait(0.1)
        self.put(message.frame_id, data, is_extended=message.is_extended_frame)
        self.device.step()
        return self.device.it.latest()

    def put(self, identifier: int, data: bytes, *, is_extended: bool) -> None:
        frame = can.Message(arbitration_id=identifier, data=data, is_extended_id=is_extended)
        frame.timestamp = self.device.clock.now_ns() / 1e9
        self.device.bus.arrived.append(frame)


def test_what_one_frame_no_longer_tells_is_not_taken_with_another(tmp_path: Path) -> None:
    pack = Pack(tmp_path)
    pack.hear("Pack2", soc=62.5, kelvin=303.2)
    pack.device.wait(5.0)
    found = pack.hear("Pack1", voltage=25_000, current=0)
    assert (found.temperature_c, found.report.soc) == (ASSUMED_C, None)


def test_frames_with_a_wrong_checksum_or_length_are_rejected(tmp_path: Path) -> None:
    frame = BatteryFrame(frame="Pack2", signals={"kelvin": "temperature K", "soc": "voltage V"})
    pack = Pack(tmp_path, frames=(frame,), checksum=Checksum.SUM8)
    assert pack.hear("Pack2", soc=20.0, kelvin=300.0).voltage_v == pytest.approx(20.0)
    pack.put(850, b"\x01\x02\x03\x07", is_extended=False)
    pack.put(850, b"\x01\x02\x03", is_extended=False)
    pack.put(850, b"\x01\x02\x03\x06\x00", is_extended=False)
    pack.device.step()
    assert pack.device.it.rejected() == 3
    pack.put(850, b"\x01\x02\x03\x06", is_extended=False)
    pack.device.step()
    assert pack.device.it.latest().voltage_v == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"frames": (BatteryFrame(frame="None", signals={"x": "voltage V"}),)}, "there is no frame None"),
        ({"frames": (BatteryFrame(frame="Pack1", signals={"x": "voltage V"}),)}, "has no signal x"),
        ({"frames": (BatteryFrame(frame="Pack1", signals={"current": "current A"}),)}, "expected a voltage"),
        ({"frames": (MAP["frames"][0], MAP["frames"][0])}, "each quantity once"),
        ({"counter": "alive"}, "has no signal alive"),
        ({"current_a": math.nan}, "expected a finite current_a"),
        ({"soc_sd": 0.0}, "expected soc_sd > 0"),
    ],
)
def test_a_map_that_does_not_fit_is_refused_in_words(tmp_path: Path, changes: Any, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        Pack(tmp_path, **changes)
