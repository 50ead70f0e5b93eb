"""Wheels of a base as a person knows them, and where the robot's file says which signal is whose."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import msgspec

from robrain.algorithms.navigation.wheel_bases import (
    WHEEL_ANGLES_RAD,
    Ackermann,
    Differential,
    Mecanum,
    Omni,
    OmniBase,
    WheelBase,
)
from robrain.deploy.bringup.findings import Patch
from robrain.plugins.device.mocdevice.frame_map import FrameMap, FrameSignals, SignalUnit
from robrain.plugins.device.mocdevice.wheel_device import WheelDevice

CORNERS = ("front left", "front right", "rear left", "rear right")


class Slot(NamedTuple):
    """One signal of a wheel."""

    frame: str
    signal: str
    unit: SignalUnit
    sign: int

    def turned(self, sign: int) -> "Slot":
        """With another sign if `sign` is -1."""
        return self._replace(sign=self.sign * sign)


def wheel_names(base: WheelBase) -> tuple[str, ...]:
    """The wheels in the order of the base."""
    match base:
        case OmniBase():
            return tuple([f"wheel at {angle * 57.29577951308232:.0f}°" for angle in WHEEL_ANGLES_RAD])
        case Omni():
            return tuple([f"wheel at {angle:g}°" for angle in base.wheel_angles_deg])
        case Mecanum():
            return CORNERS
        case Ackermann():
            return ("rear left", "rear right")
        case Differential(wheels_per_side=1):
            return ("left", "right")
        case Differential():
            sides = range(1, base.wheels_per_side + 1)
            return (*(f"left {number}" for number in sides), *(f"right {number}" for number in sides))


def positive_way(base: WheelBase) -> str:
    """What a wheel does if it turns in its positive direction."""
    if isinstance(base, OmniBase | Omni):
        return "driving the robot counter-clockwise, seen from above"
    return "driving the robot forwards"


def slots_of(frames: Sequence[FrameSignals]) -> list[Slot]:
    """Their signals in the order of the wheels."""
    found = []
    for one in frames:
        units = one.units * len(one.signals) if len(one.units) == 1 else one.units
        signs = one.signs * len(one.signals) if len(one.signs) == 1 else one.signs
        found += [Slot(one.frame, *each) for each in zip(one.signals, units, signs, strict=True)]
    return found


def frames_of(slots: Sequence[Slot]) -> list[dict[str, Any]] | None:
    """Tables of a robot's file with these signals in this order; None if a frame would be needed twice."""
    tables: list[dict[str, Any]] = []
    for slot in slots:
        if not tables or tables[-1]["frame"] != slot.frame:
            tables.append({"frame": slot.frame, "signals": [], "units": [], "signs": []})
        tables[-1]["signals"].append(slot.signal)
        tables[-1]["units"].append(slot.unit.value)
        tables[-1]["signs"].append(slot.sign)
    if len({table["frame"] for table in tables}) != len(tables):
        return None
    for table in tables:
        for key, default in (("units", SignalUnit.RAD_S.value), ("signs", 1)):
            if set(table[key]) == {default}:
                del table[key]
            elif len(set(table[key])) == 1:
                table[key] = table[key][:1]
    return tables


def frame_map(parameters: WheelDevice.Parameters) -> FrameMap | None:
    """The frames that the base's parameters describe; None if it is not on CAN."""
    frames = getattr(parameters, "frames", None)
    return frames if isinstance(frames, FrameMap) else None


def base_patch(base: WheelBase, **changes: float) -> Patch:
    """A patch with these sizes of the base.

    All its keys are in it, as a table of the file takes the place of the manifest's as a whole.
    """
    changed = msgspec.structs.replace(base, **{key: _rounded(value) for key, value in changes.items()})
    return {"mocdevice": {"base": msgspec.to_builtins(changed)}}


def _rounded(value: float) -> float:
    """To four digits: no measurement is better.

    >>> _rounded(0.0512345)
    0.05123
    """
    return value if isinstance(value, int) else float(f"{value:.4g}")
