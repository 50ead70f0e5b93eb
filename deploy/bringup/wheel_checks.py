"""Steps with the wheels in the air: the bus, the assignment of wheels, their directions, and their turns."""

import math
from collections.abc import Sequence
from functools import partial
from statistics import median
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
from robrain.deploy.bringup.bench import (
    BASE,
    BATTERY,
    WHEEL_SPEED_RAD_S,
    Bench,
    DeviceAbsent,
    EncoderSample,
    Record,
    Rest,
    StopMode,
    TurnWheels,
)
from robrain.deploy.bringup.findings import BringUpOperator, CheckFinding, CheckStep, FindingKind, Patch, conclude
from robrain.plugins.device.mocdevice.frame_map import FrameMap, FrameSignals, SignalUnit
from robrain.plugins.device.mocdevice.wheel_device import WheelDevice
from robrain.plugins.device.serial_base import LineWords
from robrain.protocol.clock import to_ns, to_seconds

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


def positive_direction(base: WheelBase) -> str:
    """Motion of a wheel that turns in its positive direction."""
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

    It has all its keys, as a table of the file replaces the manifest's as a whole.
    """
    changed = msgspec.structs.replace(base, **{key: _rounded(value) for key, value in changes.items()})
    return {"mocdevice": {"base": msgspec.to_builtins(changed)}}


def _rounded(value: float) -> float:
    """To four digits: no measurement is better.

    >>> _rounded(0.0512345)
    0.05123
    """
    return value if isinstance(value, int) else float(f"{value:.4g}")


BUS_S = 2.0
"""Time in which frames are counted."""
TURN_S = 1.6
STEADY_S = 0.5
"""After this time wheels turn as fast as they are commanded."""
RATE_MIN_HZ = 8.0
"""Fewer frames than this make no odometry for a robot that drives."""
STILL_RAD = 0.02
SILENT_RAD_S = 0.05
"""A wheel that was commanded to turn, and is slower, stands."""
COUPLED = 0.5
"""An encoder that turns by more than this share of another one turns with it."""
SCALE_TOLERANCE = 0.05
QUADRATURE = (0.25, 0.5, 2.0, 4.0)
"""Usual mistakes: edges of an encoder counted once, twice or four times."""
NEARLY = 0.03
YES, BACKWARDS, NONE, AGAIN = "y", "b", "n", "r"
"""Answers of the person."""
STOP_MAX_S, WATCHDOG_MAX_S = 0.3, 0.5


def check_bus(bench: Bench) -> list[CheckFinding]:
    """Whether the controller sends, at which rate, and whether all its frames are accepted."""
    before = bench.counters()
    record = bench.perform(Rest(BUS_S))
    after = bench.counters()
    believed, rejected = after.believed - before.believed, after.rejected - before.rejected
    foreign, lost, errors = after.foreign - before.foreign, after.lost - before.lost, after.errors - before.errors
    rate_hz = believed / BUS_S
    values = {"rate_hz": rate_hz, "rejected": rejected, "foreign": foreign, "lost": lost, "errors": errors}
    bus = partial(conclude, CheckStep.BUS, values=values)
    if not believed and rejected:
        sentence = f"all {rejected} frames of the encoders were refused"
        return [bus(FindingKind.NO_FRAMES, sentence, "check frames.checksum and dbc")]
    if not believed:
        others = f"; {foreign} other frames came" if foreign else ""
        remedy = "check power, wiring, bit rate, channel, and the names and identifiers of the frames in the DBC file"
        return [bus(FindingKind.NO_FRAMES, f"no frame of the encoders in {BUS_S:g} s{others}", remedy)]
    found = []
    if rate_hz < RATE_MIN_HZ:
        sentence = f"counts come {rate_hz:.1f} times a second"
        found.append(bus(FindingKind.FEW_FRAMES, sentence, "20 to 50 times is usual"))
    if rejected or errors:
        sentence = f"{rejected} frames were refused and {errors} error frames came in {BUS_S:g} s"
        found.append(bus(FindingKind.BAD_FRAMES, sentence, "check termination and shielding, and frames.checksum"))
    if foreign:
        sentence = f"{foreign} frames are in no file, or commands of another program"
        found.append(bus(FindingKind.FOREIGN_FRAMES, sentence, "see that nothing else drives this base", ok=None))
    turned_rad = record.samples[-1].turns_rad if record.samples else ()
    if turned_rad and max(map(abs, turned_rad)) > STILL_RAD:
        sentence = "wheels turn without a command of bring-up"
        found.append(bus(FindingKind.MOVES_BY_ITSELF, sentence, "end what else drives this base, or hold the wheels"))
    return found or [bus(FindingKind.RIGHT, f"counts of all wheels come {rate_hz:.0f} times a second")]


class WheelEffect(NamedTuple):
    """Effect of one command."""

    command: int
    """Its number."""
    wheel: int
    """The wheel that turned, by the person."""
    direction: int
    """1 if that turned in its positive direction, else -1."""
    encoder: int
    """The one that counted."""
    ratio: float
    """Counted turn, relative to the commanded turn of the wheel."""

    @property
    def sign(self) -> int:
        """Of the encoder, by the wheel's direction."""
        return self.direction if self.ratio > 0 else -self.direction


def check_wheels(bench: Bench, operator: BringUpOperator, base: WheelDevice.Parameters) -> list[CheckFinding]:
    """Turn each wheel a little, to find its encoder, its direction, and its turn."""
    names, speed = wheel_names(base.base), WHEEL_SPEED_RAD_S
    effects: list[WheelEffect] = []
    for index, name in enumerate(names):
        speeds = tuple([speed if other == index else 0.0 for other in range(len(names))])
        answer = AGAIN
        while answer == AGAIN:
            there = bench.perform(TurnWheels(speeds, TURN_S))
            answer = _turned_wheel(operator, names, index, positive_direction(base.base))
            back = bench.perform(TurnWheels(tuple([-each for each in speeds]), TURN_S))
        turned_rad_s = [0.5 * (a - b) for a, b in zip(_speeds_rad_s(there), _speeds_rad_s(back), strict=True)]
        encoder = max(range(len(names)), key=lambda other: abs(turned_rad_s[other]))
        others = [abs(each) for other, each in enumerate(turned_rad_s) if other != encoder]
        if abs(turned_rad_s[encoder]) < SILENT_RAD_S or answer == NONE:
            fault = "no wheel turns" if answer == NONE else "no encoder counts"
            sentence = f"{name}: {fault} while it is commanded to turn"
            remedy = "check motor, power stage, encoder and its cable, and the signals in frames"
            values = {"turned_rad_s": turned_rad_s[encoder], "expected_rad_s": speed}
            return [conclude(CheckStep.WHEELS, FindingKind.WHEEL_SILENT, sentence, remedy, values=values)]
        if max(others, default=0.0) > COUPLED * abs(turned_rad_s[encoder]):
            sentence = f"{name}: the encoders of several wheels count while it alone is commanded to turn"
            remedy = "put the wheels in the air, so that none turns another"
            return [conclude(CheckStep.WHEELS, FindingKind.WHEELS_UNCLEAR, sentence, remedy)]
        wheel = index if answer in (YES, BACKWARDS) else int(answer.rstrip(BACKWARDS)) - 1
        direction = -1 if answer.endswith(BACKWARDS) else 1
        effects.append(WheelEffect(index, wheel, direction, encoder, turned_rad_s[encoder] / speed))
    return [*_assign(effects, base, names), *_scale(effects, base)]


def check_halt(bench: Bench, base: WheelDevice.Parameters) -> CheckFinding:
    """Halt the host while all wheels turn."""
    record = _turn_all(bench, base, StopMode.HOST)
    driven = [sample for sample in record.samples if sample.is_commanded]
    ran_on_rad = _farthest_rad(record.samples[-1], driven[-1].turns_rad)
    after_s = ran_on_rad / max(0.1, *map(abs, _speeds_rad_s(record)))
    is_right = after_s <= STOP_MAX_S
    return conclude(
        CheckStep.HALT,
        FindingKind.RIGHT if is_right else FindingKind.SLOW_HALT,
        f"after a halt the wheels turned on by {ran_on_rad:.2f} rad, as far as in {1000 * after_s:.0f} ms",
        "" if is_right else "check the frame in frames.stop; without one the commands are 0",
        values={"ran_on_rad": ran_on_rad, "stopped_after_s": after_s},
    )


def check_watchdog(bench: Bench, base: WheelDevice.Parameters) -> CheckFinding:
    """Send no more commands while all wheels turn, as if this computer died."""
    record = _turn_all(bench, base, StopMode.SILENCE)
    driven = [sample for sample in record.samples if sample.is_commanded]
    last = record.samples[-1].turns_rad
    moving = [sample for sample in record.samples if _farthest_rad(sample, last) > STILL_RAD]
    stopped_ns = moving[-1].stamp_ns if moving else driven[-1].stamp_ns
    after_s = max(0.0, to_seconds(stopped_ns - driven[-1].stamp_ns))
    is_right = after_s <= WATCHDOG_MAX_S
    remedy = "set the controller's watchdog to 200 ms: without it a robot drives on if this computer dies"
    return conclude(
        CheckStep.WATCHDOG,
        FindingKind.RIGHT if is_right else FindingKind.NO_WATCHDOG,
        f"{1000 * after_s:.0f} ms after the last command the wheels {'stood' if is_right else 'still turned'}",
        "" if is_right else remedy,
        values={"stopped_after_s": after_s},
    )


def _turn_all(bench: Bench, base: WheelDevice.Parameters, ending: StopMode) -> Record:
    """Turn all wheels, and back afterwards."""
    record = bench.perform(TurnWheels((WHEEL_SPEED_RAD_S,) * base.base.wheels, TURN_S, ending))
    bench.perform(TurnWheels((-WHEEL_SPEED_RAD_S,) * base.base.wheels, TURN_S))
    return record


def check_battery(bench: Bench) -> CheckFinding:
    """Whether the battery's measurements are there and make sense."""
    battery = partial(conclude, CheckStep.BATTERY)
    if fault := bench.fault_of(BATTERY):
        return battery(FindingKind.NOT_DONE, f"the battery's device does not run: {fault}")
    try:
        latest = bench.call(BATTERY, "latest")
    except DeviceAbsent as error:
        return battery(FindingKind.NOT_DONE, str(error))
    if latest is None:
        remedy = "check [parameters.bm2], or choose another battery in [robot.roles]"
        return battery(FindingKind.NOT_DONE, "the battery has reported nothing", remedy)
    values = {name: latest[name] for name in ("voltage_v", "current_a", "temperature_c")}
    voltage_v, current_a, _ = values.values()
    if not (3.0 <= voltage_v <= 100.0 and math.isfinite(current_a) and abs(current_a) < 500.0):
        sentence = f"{voltage_v:.1f} V and {current_a:.1f} A cannot be a robot's battery"
        remedy = "check scale and signals of its frame"
        return battery(FindingKind.BATTERY_IMPLAUSIBLE, sentence, remedy, values=values)
    if current_a < -0.05:
        sentence = f"{voltage_v:.1f} V, and {-current_a:.2f} A flow into the battery"
        remedy = "if the robot does not charge, the sign of the current is wrong: it is positive while discharging"
        return battery(FindingKind.BATTERY_IMPLAUSIBLE, sentence, remedy, values=values, ok=None)
    return battery(FindingKind.RIGHT, f"{voltage_v:.1f} V, {current_a:.2f} A", values=values)


def _turned_wheel(operator: BringUpOperator, names: tuple[str, ...], index: int, direction: str) -> str:
    """Answer of the person: YES, BACKWARDS, NONE, AGAIN, or the number of another wheel, with BACKWARDS behind it."""
    choices = {YES: f"{names[index]}, {direction}", BACKWARDS: f"{names[index]}, the other way round"}
    for other, name in enumerate(names):
        if other != index:
            choices[f"{other + 1}"] = f"{name}, {direction}"
            choices[f"{other + 1}{BACKWARDS}"] = f"{name}, the other way round"
    choices |= {NONE: "none", AGAIN: "turn it again"}
    return operator.choose(f"{names[index]} was commanded to turn, {direction}. Which wheel turned?", choices, YES)


def _assign(effects: list[WheelEffect], base: WheelDevice.Parameters, names: tuple[str, ...]) -> list[CheckFinding]:
    """Name swapped or inverted signals, with their corrections."""
    wheels = partial(conclude, CheckStep.WHEELS)
    numbers = list(range(len(names)))
    if sorted(one.wheel for one in effects) != numbers or sorted(one.encoder for one in effects) != numbers:
        return [wheels(FindingKind.WHEELS_UNCLEAR, "two commands turn one wheel, or count on one encoder", "try again")]
    found: list[tuple[FindingKind, str]] = []
    if swapped := [one for one in effects if one.wheel != one.command]:
        pairs = ", ".join(f"{names[one.command]} turns {names[one.wheel]}" for one in swapped)
        found.append((FindingKind.MOTORS_SWAPPED, f"commands of wheels are swapped: that of {pairs}"))
    if crossed := [one for one in effects if one.encoder != one.wheel]:
        pairs = ", ".join(f"that of {names[one.encoder]} counts {names[one.wheel]}" for one in crossed)
        found.append((FindingKind.ENCODERS_SWAPPED, f"encoders of wheels are swapped: {pairs}"))
    for one in effects:
        if one.direction < 0:
            found.append((FindingKind.MOTOR_INVERTED, f"{names[one.wheel]}: the motor turns the wrong way"))
        if one.sign < 0:
            found.append((FindingKind.ENCODER_INVERTED, f"{names[one.wheel]}: the encoder counts the wrong way"))
    if not found:
        sentence = f"each of {', '.join(names)} turns as it is commanded, and its own encoder counts"
        return [wheels(FindingKind.RIGHT, sentence)]
    patch = _wheels_patch(effects, base)
    remedy = "" if patch else "its file cannot say that: change the wiring, or the parameters of its base"
    return [wheels(kind, sentence, remedy, patch=patch) for kind, sentence in found]


def _wheels_patch(effects: list[WheelEffect], base: WheelDevice.Parameters) -> Patch:
    frames = frame_map(base)
    if frames is None:
        return _signs_patch(effects, base)
    commands, encoders = slots_of(frames.commands), slots_of(frames.encoders)
    new_commands: list[Slot] = list(commands)
    new_encoders: list[Slot] = list(encoders)
    for one in effects:
        new_commands[one.wheel] = commands[one.command].turned(one.direction)
        new_encoders[one.wheel] = encoders[one.encoder].turned(one.sign)
    changed = {}
    for key, old, new in (("commands", commands, new_commands), ("encoders", encoders, new_encoders)):
        if new != old:
            tables = frames_of(new)
            if tables is None:
                return {}
            changed[key] = tables
    return {BASE: {"frames": changed}}


def _signs_patch(effects: list[WheelEffect], base: WheelDevice.Parameters) -> Patch:
    """Signs for a base that speaks lines of text; empty if wheels are swapped, or for another protocol."""
    lines, codec = getattr(base, "lines", None), getattr(base, "codec", None)
    if not isinstance(lines, LineWords) or codec:
        return {}
    if any(not one.command == one.wheel == one.encoder for one in effects):
        return {}
    signs, command_signs = list(_each(lines.signs, effects)), list(_each(lines.command_signs or lines.signs, effects))
    for one in effects:
        signs[one.wheel] *= one.sign
        command_signs[one.wheel] *= one.direction
    # Whole, as a table of the file replaces the manifest's.
    return {BASE: {"lines": {**msgspec.to_builtins(lines), "signs": signs, "command_signs": command_signs}}}


def _each(signs: Sequence[int], effects: list[WheelEffect]) -> Sequence[int]:
    return signs if len(signs) == len(effects) else tuple(signs) * len(effects)


def _scale(effects: list[WheelEffect], base: WheelDevice.Parameters) -> list[CheckFinding]:
    """Whether the encoders count as many ticks a turn as the file states, by the commanded speed."""
    ratios = [abs(one.ratio) for one in effects]
    ratio = median(ratios)
    values = {f"wheel_{one.encoder + 1}_by_command": abs(one.ratio) for one in effects}
    scale = partial(conclude, CheckStep.SCALE)
    if max(abs(each / ratio - 1.0) for each in ratios) > 2 * SCALE_TOLERANCE:
        shares = ", ".join(f"{100 * each:.0f} %" for each in ratios)
        sentence = f"wheels with the same command turn differently far: {shares}"
        remedy = "check that all encoders are alike, and that no wheel is blocked"
        return [scale(FindingKind.WRONG_SCALE, sentence, remedy, values=values)]
    if abs(ratio - 1.0) <= SCALE_TOLERANCE:
        sentence = f"wheels turn {100 * ratio:.1f} % as far as they are commanded"
        return [scale(FindingKind.RIGHT, sentence, values=values)]
    frames = frame_map(base)
    counts = frames is None or frames.measure == "counts"
    plain = next((one for one in QUADRATURE if abs(ratio / one - 1.0) < NEARLY), ratio)
    before = base.base.encoder_ticks_per_turn
    ticks = max(1, round(before * plain))
    advice = f"a turn has {ticks} counts, not {before}" if counts else "check units"
    return [
        scale(
            FindingKind.WRONG_SCALE,
            f"encoders report {ratio:.2f} times the turns that wheels were commanded: {advice}",
            "if the wheels turned at another speed than 2 rad/s, the unit of the commands is wrong instead",
            values={**values, "encoder_ticks_per_turn": float(ticks)},
            patch=base_patch(base.base, encoder_ticks_per_turn=ticks) if counts else None,
        )
    ]


def _speeds_rad_s(record: Record) -> list[float]:
    """Of each encoder, once the wheels turned as fast as they were commanded."""
    driven = [sample for sample in record.samples if sample.is_commanded]
    begin_ns = driven[0].stamp_ns + to_ns(STEADY_S)
    first, last = next((sample for sample in driven if sample.stamp_ns >= begin_ns), driven[0]), driven[-1]
    elapsed_s = max(to_seconds(last.stamp_ns - first.stamp_ns), 1e-3)
    return [(b - a) / elapsed_s for a, b in zip(first.turns_rad, last.turns_rad, strict=True)]


def _farthest_rad(sample: EncoderSample, turns_rad: Sequence[float]) -> float:
    return max(abs(a - b) for a, b in zip(sample.turns_rad, turns_rad, strict=True))
