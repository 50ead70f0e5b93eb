"""A battery on CAN by description: other frames, units, signs and checksums than the Robertino's."""

import math
from pathlib import Path
from typing import Any

import can
import cantools
import msgspec
import pytest

from robrain.algorithms.energy.battery_report import BatteryReport
from robrain.plugins.device.bm2.bm2 import BatteryFrame, BatteryMap, Bm2, PackValue
from robrain.plugins.device.bm2.interface import ASSUMED_C
from robrain.plugins.device.mocdevice.frame_map import Checksum
from robrain.protocol.can.frames import codec
from robrain.protocol.can.payload import ID_MASK
from tests.plugins.device.bare_device import BareDevice

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
        BatteryFrame(frame="Pack1", signals={"voltage": PackValue.VOLTAGE_MV, "current": PackValue.CURRENT_MA}),
        BatteryFrame(frame="Pack2", signals={"soc": PackValue.SOC_PERCENT, "kelvin": PackValue.TEMPERATURE_K}),
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


def test_signals_of_any_frames_are_measurements_in_volts_and_amperes(tmp_path: Path) -> None:
    pack = Pack(tmp_path)
    assert pack.hear("Pack2", soc=62.5, kelvin=303.2) is None
    found = pack.hear("Pack1", voltage=25_550, current=-3_000)
    assert (found.voltage_v, found.current_a) == (pytest.approx(25.55), pytest.approx(3.0))
    assert found.temperature_c == pytest.approx(30.05)
    assert found.report == BatteryReport(soc=0.625)
    again = pack.hear("Pack1", voltage=25_550, current=1_000)
    assert again.current_a == pytest.approx(-1.0)
    assert again.charge_c == pytest.approx(-0.1)


def test_what_one_frame_no_longer_tells_is_not_taken_with_another(tmp_path: Path) -> None:
    pack = Pack(tmp_path)
    pack.hear("Pack2", soc=62.5, kelvin=303.2)
    pack.device.wait(5.0)
    found = pack.hear("Pack1", voltage=25_000, current=0)
    assert (found.temperature_c, found.report.soc) == (ASSUMED_C, None)


def test_a_battery_without_a_current_says_that_it_is_guessed(tmp_path: Path) -> None:
    frames = (BatteryFrame(frame="Pack1", signals={"voltage": PackValue.VOLTAGE_MV}),)
    found = Pack(tmp_path, frames=frames, current_a=2.0).hear("Pack1", voltage=24_000)
    assert (found.current_a, found.temperature_c) == (2.0, ASSUMED_C)
    assert found.report == BatteryReport(has_current=False)


def test_frames_with_a_wrong_checksum_or_length_are_rejected(tmp_path: Path) -> None:
    frame = BatteryFrame(frame="Pack2", signals={"kelvin": PackValue.TEMPERATURE_K, "soc": PackValue.VOLTAGE_V})
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


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_what_is_no_number_is_rejected(tmp_path: Path, value: float) -> None:
    pack = Pack(tmp_path, frames=(BatteryFrame(frame="Float", signals={"volts": PackValue.VOLTAGE_V}),))
    assert pack.hear("Float", volts=24.5).voltage_v == 24.5
    assert pack.hear("Float", volts=value).voltage_v == 24.5
    assert pack.device.it.rejected() == 1


def test_the_bus_is_asked_for_the_batterys_frames_alone(tmp_path: Path) -> None:
    ((_, _, options),) = Pack(tmp_path).device.opened
    first, second = options["can_filters"]
    assert first == {"can_id": 2566834709 & ID_MASK, "can_mask": ID_MASK, "extended": True}
    assert second == {"can_id": 850, "can_mask": 0x7FF, "extended": False}


def test_the_robertinos_battery_is_the_default_and_reports_nothing_more() -> None:
    device = BareDevice(Bm2)
    device.it.activate()
    device.hear("BatteryStatus", 1, voltage_v=15.0, current_a=1.5, temperature_c=20.0)
    device.step()
    assert device.it.latest().report is msgspec.UNSET
    assert b"report" not in msgspec.json.encode(device.it.latest())
    assert BatteryMap().frames[0].frame == codec("BatteryStatus").name


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"frames": (BatteryFrame(frame="None", signals={"x": PackValue.VOLTAGE_V}),)}, "there is no frame None"),
        ({"frames": (BatteryFrame(frame="Pack1", signals={"x": PackValue.VOLTAGE_V}),)}, "has no signal x"),
        ({"frames": (BatteryFrame(frame="Pack1", signals={"current": PackValue.CURRENT_A}),)}, "expected a voltage"),
        ({"frames": (MAP["frames"][0], MAP["frames"][0])}, "each quantity once"),
        ({"counter": "alive"}, "has no signal alive"),
        ({"current_a": math.nan}, "expected a finite current_a"),
        ({"soc_sd": 0.0}, "expected soc_sd > 0"),
    ],
)
def test_a_map_that_does_not_fit_is_refused_in_words(tmp_path: Path, changes: Any, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        Pack(tmp_path, **changes)
