"""Questions to the person beside the robot, and the results of bring-up: values, codes and sentences."""

import math
import sys
from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import Any

import msgspec

from robrain.deploy.command_line.output import print_message


class BringUpOperator:
    """The person beside the robot; this one gives the default answers, and wheels turn as they are commanded."""

    def prepare(self, what: str) -> None:
        """Give an instruction; returns when the person has done it."""

    def choose(self, question: str, choices: Mapping[str, str], default: str) -> str:
        """Ask; returns a key of `choices`.

        Args:
            question: a sentence.
            choices: meaning of each answer.
            default: the answer if the person just presses Enter.

        """
        return default

    def number(self, question: str) -> float:
        """Ask for a finite number; without a person there is no measurement."""
        return 0.0


class TerminalOperator(BringUpOperator):
    """Asks on stderr, and reads lines of stdin; raises EOFError at its end."""

    def prepare(self, what: str) -> None:
        """As BringUpOperator."""
        self._read(f"{what}, then press Enter (Ctrl-C ends) ")

    def choose(self, question: str, choices: Mapping[str, str], default: str) -> str:
        """As BringUpOperator."""
        print_message(question)
        for key, meaning in choices.items():
            print_message(f"  {key:<3} {meaning}{'  (Enter)' if key == default else ''}")
        while True:
            answer = self._read("> ").strip().lower() or default
            if answer in choices:
                return answer
            print_message(f"expected one of {', '.join(choices)}")

    def number(self, question: str) -> float:
        """As BringUpOperator."""
        while True:
            answer = self._read(f"{question}: ").strip()
            try:
                value = float(answer)
            except ValueError:
                value = math.nan
            if math.isfinite(value):
                return value
            print_message("expected a number, such as -0.015")

    def _read(self, prompt: str) -> str:
        sys.stderr.write(prompt)
        sys.stderr.flush()
        line = sys.stdin.readline()
        if not line:
            raise EOFError("the input has ended")
        return line


NOTHING: Mapping[str, float] = MappingProxyType({})
Patch = dict[str, dict[str, Any]]
"""New values for a robot's file: by plugin, the keys of its `[parameters.PLUGIN]`."""


class CheckStep(StrEnum):
    """Steps in their order; the first six are done with the wheels in the air."""

    BUS = "bus"
    WHEELS = "wheels"
    SCALE = "scale"
    HALT = "halt"
    WATCHDOG = "watchdog"
    BATTERY = "battery"
    SCAN = "scan"
    ORIENTATION = "orientation"
    DISTANCE = "distance"
    TURN = "turn"
    IMU = "imu"
    SQUARE = "square"


class FindingKind(StrEnum):
    """Kinds of findings; a correct value is `right`, and an impossible check `not_done`."""

    RIGHT = "right"
    NOT_DONE = "not_done"
    FAILED = "failed"
    """A motion was given up, or a device does not run."""
    NO_FRAMES = "no_frames"
    FEW_FRAMES = "few_frames"
    BAD_FRAMES = "bad_frames"
    FOREIGN_FRAMES = "foreign_frames"
    MOVES_BY_ITSELF = "moves_by_itself"
    WHEEL_SILENT = "wheel_silent"
    ENCODER_INVERTED = "encoder_inverted"
    MOTOR_INVERTED = "motor_inverted"
    ENCODERS_SWAPPED = "encoders_swapped"
    MOTORS_SWAPPED = "motors_swapped"
    WHEELS_UNCLEAR = "wheels_unclear"
    WRONG_SCALE = "wrong_scale"
    SLOW_HALT = "slow_halt"
    NO_WATCHDOG = "no_watchdog"
    BATTERY_IMPLAUSIBLE = "battery_implausible"
    NO_SCANS = "no_scans"
    SCAN_MIRRORED = "scan_mirrored"
    SCAN_TURNED = "scan_turned"
    LIDAR_OFF_CENTRE = "lidar_off_centre"
    WRONG_WHEEL_RADIUS = "wrong_wheel_radius"
    WRONG_TRACK = "wrong_track"
    NO_IMU = "no_imu"
    IMU_INVERTED = "imu_inverted"
    WRONG_IMU_SCALE = "wrong_imu_scale"
    UNEQUAL_WHEELS = "unequal_wheels"


class CheckFinding(msgspec.Struct, frozen=True):
    """One thing that was found."""

    step: CheckStep
    found: FindingKind
    ok: bool | None
    """Whether it is as it should be; None if that is not known."""
    sentence: str
    values: dict[str, float] = {}
    """Measured figures by name, with their units in the names."""
    patch: Patch = {}
    """Change for the robot's file; empty if the value is to stay, or a program must not change it."""
    remedy: str = ""
    """Remedy that a person can apply."""

    @property
    def stops(self) -> bool:
        """Whether it would be unsafe, or of no use, to continue."""
        return self.found in _STOPS


def conclude(
    step: CheckStep,
    kind: FindingKind,
    sentence: str,
    remedy: str = "",
    *,
    values: Mapping[str, float] = NOTHING,
    patch: Patch | None = None,
    ok: bool | None = False,
) -> CheckFinding:
    """One thing that was found; `right` is ok, and `not_done` neither ok nor wrong."""
    is_ok = {FindingKind.RIGHT: True, FindingKind.NOT_DONE: None}.get(kind, ok)
    return CheckFinding(step, kind, is_ok, sentence, dict(values), patch or {}, remedy)


class BringUpReport(msgspec.Struct, frozen=True, kw_only=True):
    """Output of `--json`."""

    robot: str
    file: str
    backup: str
    """Copy of the file as it was; empty if it was not changed."""
    findings: list[CheckFinding]

    @property
    def is_good(self) -> bool:
        """Whether no check failed; checks that were impossible do not count."""
        return all(finding.ok is not False for finding in self.findings)


_STOPS = frozenset(
    {
        FindingKind.FAILED,
        FindingKind.NO_FRAMES,
        FindingKind.MOVES_BY_ITSELF,
        FindingKind.WHEEL_SILENT,
        FindingKind.WHEELS_UNCLEAR,
        FindingKind.SLOW_HALT,
        FindingKind.NO_WATCHDOG,
        FindingKind.NO_SCANS,
    }
)
