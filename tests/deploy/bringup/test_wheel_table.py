"""Which signal is whose: what a robot's file says of it, and what it can say."""

import msgspec
import pytest

from robrain.algorithms.navigation.wheel_bases import Ackermann, Differential, Mecanum, Omni, OmniBase, WheelBase
from robrain.deploy.bringup.wheel_checks import base_patch, frames_of, positive_direction, slots_of, wheel_names
from robrain.plugins.device.mocdevice.frame_map import FrameMap, FrameSignals, SignalUnit

SIZES = {"wheel_radius_m": 0.05, "encoder_ticks_per_turn": 4096}
TWO = Differential(track_m=0.3, **SIZES)


@pytest.mark.parametrize(
    ("base", "names"),
    [
        (OmniBase(), ("wheel at 60°", "wheel at 180°", "wheel at 300°")),
        (Omni(wheel_distance_m=0.2, wheel_angles_deg=(45, 135, 225, 315), **SIZES), ("wheel at 45°", "wheel at 135°")),
        (Mecanum(wheelbase_m=0.3, track_m=0.3, **SIZES), ("front left", "front right", "rear left", "rear right")),
        (TWO, ("left", "right")),
        (Differential(track_m=0.3, wheels_per_side=2, **SIZES), ("left 1", "left 2", "right 1", "right 2")),
        (Ackermann(wheelbase_m=0.3, track_m=0.2, steering_max_rad=0.5, **SIZES), ("rear left", "rear right")),
    ],
)
def test_each_wheel_has_a_name_in_the_order_of_its_base(base: WheelBase, names: tuple[str, ...]) -> None:
    assert wheel_names(base)[: len(names)] == names
    assert len(wheel_names(base)) == base.wheels
    assert ("counter-clockwise" in positive_direction(base)) == isinstance(base, OmniBase | Omni)


def test_signals_keep_their_units_and_signs_in_another_order() -> None:
    frames = (
        FrameSignals(frame="A", signals=("a", "b"), units=(SignalUnit.RPM, SignalUnit.RAD_S), signs=(1, -1)),
        FrameSignals(frame="B", signals=("c",), units=(SignalUnit.M_S,)),
    )
    a, b, c = slots_of(frames)
    assert (b.sign, b.unit, c.sign) == (-1, SignalUnit.RAD_S, 1)
    tables = frames_of([c, b.turned(-1), a])
    assert tables is not None
    read = msgspec.convert(tables, tuple[FrameSignals, ...])
    assert slots_of(read) == [c, b.turned(-1), a]
    assert frames_of([a, c, b]) is None  # frame A would be needed twice


def test_defaults_are_left_out_of_tables() -> None:
    assert frames_of(slots_of(FrameMap().encoders)) == [
        {"frame": "WheelEncoders", "signals": ["wheel_1_ticks", "wheel_2_ticks", "wheel_3_ticks"]}
    ]


def test_a_patch_of_a_base_is_a_whole_base_with_figures_of_four_digits() -> None:
    table = base_patch(TWO, wheel_radius_m=0.0512345)["mocdevice"]["base"]
    assert table["wheel_radius_m"] == 0.05123
    assert msgspec.convert(table, WheelBase) == msgspec.structs.replace(TWO, wheel_radius_m=0.05123)
    assert base_patch(TWO, encoder_ticks_per_turn=16384)["mocdevice"]["base"]["encoder_ticks_per_turn"] == 16384
