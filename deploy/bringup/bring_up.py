"""The steps of bring-up in their order; results are put into the robot's file before the next step."""

import os
import shutil
import tempfile
from collections.abc import Callable, Mapping, MutableMapping, MutableSequence
from pathlib import Path
from typing import Any

import msgspec
import tomlkit
from tomlkit.exceptions import TOMLKitError

from robrain.agent.host.robot_file import RobotFile, read_robot_file
from robrain.algorithms.navigation.wheel_bases import Ackermann
from robrain.deploy.bringup.bench import (
    DRIVER,
    LIDAR,
    LIDAR_START_S,
    START_S,
    Bench,
    DeviceAbsent,
    MotionFailed,
    has_imu,
)
from robrain.deploy.bringup.findings import (
    BringUpOperator,
    BringUpReport,
    CheckFinding,
    CheckStep,
    FindingKind,
    Patch,
    conclude,
)
from robrain.deploy.bringup.floor_checks import (
    MORE_WALLS,
    NoSight,
    check_distance,
    check_imu,
    check_orientation,
    check_scan,
    check_square,
    check_turn,
)
from robrain.deploy.bringup.wheel_checks import check_battery, check_bus, check_halt, check_watchdog, check_wheels
from robrain.deploy.errors import UsageError
from robrain.plugins.device.mocdevice.wheel_device import WheelDevice

PARAMETERS = "parameters"
BACKUPS_MAX = 1000


def patched(parameters: Mapping[str, Any], patch: Mapping[str, Any]) -> dict[str, Any]:
    """One table over another, within nested tables too; lists are replaced.

    >>> patched({"scan": {"silent_s": 3.0}}, {"scan": {"mount": {"yaw_rad": 1.5}}})
    {'scan': {'silent_s': 3.0, 'mount': {'yaw_rad': 1.5}}}
    """
    found = dict(parameters)
    for key, value in patch.items():
        below = found.get(key)
        found[key] = (
            patched(below if isinstance(below, Mapping) else {}, value) if isinstance(value, Mapping) else value
        )
    return found


def write_patch(path: Path, patch: Patch, backup: Path | None) -> Path:
    """Write new values into a robot's file, which is replaced as a whole or not at all.

    Args:
        path: the file.
        patch: changes of values.
        backup: a copy that was made before; None makes one.

    Returns:
        The copy of the file as it was.

    Raises:
        UsageError: the file is not as it was read, or cannot be written.
        RobotFileError: it would not be a robot's file any more.

    """
    try:
        document = tomlkit.parse(path.read_text(encoding="utf-8-sig"))
        if PARAMETERS not in document:
            document[PARAMETERS] = tomlkit.table(is_super_table=True)
        _put(document[PARAMETERS], patch)
        kept = backup or _backup(path)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".toml")
        new = Path(name)
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as stream:
                stream.write(tomlkit.dumps(document))
                stream.flush()
                os.fsync(stream.fileno())
            read_robot_file(new)
            shutil.copymode(path, new)
            new.replace(path)
        finally:
            new.unlink(missing_ok=True)
    except (OSError, TOMLKitError) as error:
        raise UsageError(f"{path}: cannot write what was found: {error}") from error
    return kept


def _backup(path: Path) -> Path:
    for number in range(1, BACKUPS_MAX):
        copy = path.with_name(f"{path.name}.before-bringup{'' if number == 1 else f'-{number}'}")
        try:
            with path.open("rb") as source, copy.open("xb") as target:
                shutil.copyfileobj(source, target)
        except FileExistsError:
            continue
        shutil.copystat(path, copy)
        return copy
    raise UsageError(f"{path}: too many copies {path.name}.before-bringup-… beside it")


def _put(table: MutableMapping[str, Any], patch: Mapping[str, Any]) -> None:
    for key, value in patch.items():
        there = table.get(key)
        if isinstance(value, Mapping):
            if not isinstance(there, MutableMapping):
                table[key] = tomlkit.table()
            _put(table[key], value)
        elif not _changed_in_place(there, value) and there != value:
            table[key] = value


def _changed_in_place(there: Any, value: Any) -> bool:
    """Change a list of tables one by one, so that their comments stay; whether that was possible."""
    if not (isinstance(there, MutableSequence) and isinstance(value, list) and len(there) == len(value) > 0):
        return False
    if not all(isinstance(one, Mapping) for one in (*there, *value)):
        return False
    for old, new in zip(there, value, strict=True):
        for key in [key for key in old if key not in new]:
            del old[key]
        _put(old, new)
    return True


IN_THE_AIR = "Put the robot on a stand, so that all its wheels turn freely"
ON_THE_FLOOR = "Put the robot on the floor, with 1.5 m free all around it and walls within sight of its lidar"


class BringUpOptions(msgspec.Struct, frozen=True, kw_only=True):
    """Steps and limits of a bring-up."""

    air: bool = True
    """Steps with the wheels in the air."""
    floor: bool = True
    """Steps on the floor."""
    rounds: int = 1
    """Squares of each kind; 0 for none."""
    measured: bool = False
    """A person measures where squares end."""
    write: bool = True
    """Put the results into the file."""


class _Ended(Exception):
    """The result of a step makes it unsafe, or useless, to continue."""


class BringUp:
    """One run of the steps.

    Args:
        path: the robot's file.
        bench: closed by its owner.
        operator: the person beside the robot.
        on_finding: called with each finding.
        robot_file: values of the file, where they differ from the given ones (endpoints, team).

    """

    def __init__(
        self,
        path: Path,
        bench: Bench,
        operator: BringUpOperator,
        on_finding: Callable[[CheckFinding], None],
        robot_file: RobotFile | None = None,
    ) -> None:
        self._path, self._bench, self._operator, self._on_finding = path, bench, operator, on_finding
        self._file = read_robot_file(path) if robot_file is None else robot_file
        self._findings: list[CheckFinding] = []
        self._backup: Path | None = None
        self._step = CheckStep.BUS
        self._with_lidar = False

    def run(self, wanted: BringUpOptions) -> BringUpReport:
        """Do all steps that are possible.

        Raises:
            RobrainError: the host cannot start, or the file cannot be written.
            EOFError, KeyboardInterrupt: the person has gone, or ended it; the wheels stand once the bench is closed.

        """
        self._wanted = wanted
        try:
            if wanted.air:
                self._operator.prepare(IN_THE_AIR)
            self._start(with_lidar=False)
            self._air(moves=wanted.air)
            if wanted.floor:
                self._operator.prepare(ON_THE_FLOOR)
                self._start(with_lidar=True)
                self._floor()
        except _Ended:
            pass
        except (MotionFailed, DeviceAbsent) as error:
            remedy = MORE_WALLS if isinstance(error, NoSight) else ""
            self._record([conclude(self._step, FindingKind.FAILED, str(error), remedy)])
        return BringUpReport(
            robot=self._file.robot.name, file=str(self._path), backup=str(self._backup or ""), findings=self._findings
        )

    def _air(self, *, moves: bool) -> None:
        bench = self._bench
        self._do(CheckStep.BUS, lambda: check_bus(bench))
        base = bench.base()
        if not moves:
            return
        if base is None or not bench.has_wheels or isinstance(base.base, Ackermann):
            self._skip(CheckStep.WHEELS, "this base is not commanded wheel by wheel")
        else:
            self._do(CheckStep.WHEELS, lambda: check_wheels(bench, self._operator, base))
            self._do(CheckStep.HALT, lambda: [check_halt(bench, self._base())])
            self._do(CheckStep.WATCHDOG, lambda: [check_watchdog(bench, self._base())])
        self._do(CheckStep.BATTERY, lambda: [check_battery(bench)])

    def _floor(self) -> None:
        bench, base, wanted = self._bench, self._bench.base(), self._wanted
        self._do(CheckStep.SCAN, lambda: [check_scan(bench)])
        if base is not None and isinstance(base.base, Ackermann):
            sentence = "this base cannot turn on the spot: measure the lidar's mounting and the track by hand"
            self._skip(CheckStep.ORIENTATION, sentence)
            return
        self._do(CheckStep.ORIENTATION, lambda: check_orientation(bench))
        self._do(CheckStep.DISTANCE, lambda: check_distance(bench))
        self._do(CheckStep.TURN, lambda: check_turn(bench))
        if has_imu(self._file):
            self._step = CheckStep.IMU
            self._start(with_lidar=True, with_imu=True)
            bench.keep_gyro_out()
            if not any(one.patch for one in self._do(CheckStep.IMU, lambda: check_imu(bench))):
                self._start(with_lidar=True)  # the squares are the wheels' alone
        for _ in range(2 if wanted.rounds else 0):  # again with the corrections of the first ones
            found = self._do(
                CheckStep.SQUARE,
                lambda: check_square(bench, self._operator, rounds=wanted.rounds, measured=wanted.measured),
            )
            if not any(one.patch for one in found):
                break

    def _base(self) -> WheelDevice.Parameters:
        base = self._bench.base()
        assert base is not None
        return base

    def _start(self, *, with_lidar: bool, with_imu: bool = False) -> None:
        self._with_lidar = with_lidar
        self._bench.start(self._file, with_lidar=with_lidar, with_imu=with_imu)
        self._bench.wait_for_data(DRIVER, START_S)
        if with_lidar:
            self._bench.wait_for_data(LIDAR, LIDAR_START_S)

    def _skip(self, step: CheckStep, sentence: str) -> None:
        self._record([conclude(step, FindingKind.NOT_DONE, sentence)])

    def _do(self, step: CheckStep, check: Callable[[], list[CheckFinding]]) -> list[CheckFinding]:
        """Do a step, record its findings, and start the devices again if they have changed the file."""
        self._step = step
        found = check()
        self._record(found)
        if any(one.stops for one in found):
            raise _Ended
        if any(one.patch for one in found):
            self._start(with_lidar=self._with_lidar)
        return found

    def _record(self, found: list[CheckFinding]) -> None:
        for one in found:
            self._findings.append(one)
            self._on_finding(one)
            if not one.patch:
                continue
            parameters = patched(self._file.parameters, one.patch)
            self._file = msgspec.structs.replace(self._file, parameters=parameters)
            if self._wanted.write:
                self._backup = write_patch(self._path, one.patch, self._backup)
