#!/usr/bin/env python3
"""Updates robrain on one machine so that it can be taken back: `robrain-update`.

Copy it to /usr/local/bin/robrain-update; it needs Python 3.11 and pip (Debian: python3-venv, python3-pip) and nothing
of robrain. /opt/robrain has two slots, the virtual environments `a` and `b`; the link `current` names the one in use:

    robrain-update install 'robrain[navigation]==0.2.0' --restart robrain-agent@r1 \
        --health 'robrain plugin list r1'
    robrain-update status | back | recover

`install` fills the other slot, tries what is in it, points the link at it, restarts the units and runs the health check
until it succeeds. If it does not succeed in time, or the process is interrupted, link and units go back. `recover`
does that after a power cut in the middle; a unit runs it at boot.
"""

import argparse
import fcntl
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
import venv
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TypedDict

SLOTS = ("a", "b")
CURRENT, STATE, LOCK = "current", "update.json", "update.lock"
HEALTH_S, PAUSE_S = 60.0, 1.0
TRIAL_S = 30.0
"""How long `robrain --version` may take in a new slot."""
TRYING, GOOD, BAD = "trying", "good", "bad"
EXIT_FAILED, EXIT_USAGE = 1, 2


class State(TypedDict):
    """What is written down of an update: the file `update.json`."""

    slot: str
    """The slot that was filled last."""
    back_to: str
    """The slot in use before; empty if there was none."""
    requirement: str
    version: str
    state: str
    """`trying` from before the link changes until the health check has succeeded, then `good`; `bad` if taken back."""
    why: str
    restart: list[str]


class UpdateError(Exception):
    """An update is not made, or was taken back; the text is one sentence."""


class Machine:
    """The slots of one machine.

    Args:
        root: the folder of the slots.
        systemctl: the command that restarts units.

    """

    def __init__(self, root: Path, systemctl: Sequence[str] = ("systemctl",)) -> None:
        self.root, self._systemctl = root, list(systemctl)

    @property
    def current(self) -> str:
        """The slot in use; empty if there is none."""
        link = self.root / CURRENT
        name = os.readlink(link) if link.is_symlink() else ""
        return name if name in SLOTS else ""

    def state(self) -> State | None:
        """What is written down of the last update; None if nothing is."""
        try:
            found: State = json.loads((self.root / STATE).read_text(encoding="utf-8"))
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            raise UpdateError(f"{self.root / STATE} cannot be read: {error}; remove it if {CURRENT} works") from error
        return found

    @contextmanager
    def alone(self) -> Iterator[None]:
        """No other update runs during the block (UpdateError)."""
        self.root.mkdir(parents=True, exist_ok=True)
        with (self.root / LOCK).open("w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise UpdateError("another update is running") from error
            yield

    def install(
        self,
        requirement: str,
        pip_options: Sequence[str] = (),
        restart: Sequence[str] = (),
        health: str = "",
        health_s: float = HEALTH_S,
    ) -> State:
        """Install a version into the other slot, use it if it is healthy, and else go back.

        Args:
            requirement: as pip takes it.
            pip_options: options of `pip install`.
            restart: units that use robrain.
            health: a command, run with the new slot's programs first in PATH; it has succeeded when it ends with 0.
            health_s: how long it may take to succeed.

        Raises:
            UpdateError: the version in use is that of before.

        """
        last = self.state()
        if last is not None and last["state"] == TRYING:
            raise UpdateError("the last update was interrupted; run: robrain-update recover")
        before = self.current
        slot = SLOTS[before == SLOTS[0]]
        version = self._fill(slot, requirement, pip_options)
        state = State(
            slot=slot, back_to=before, requirement=requirement, version=version, state=TRYING, why="",
            restart=list(restart),
        )  # fmt: skip
        self._write(state)
        try:
            self._point_at(slot)
            self._restart(restart)
            self._until_healthy(slot, health, health_s)
        except BaseException as error:  # Ctrl-C as well
            why = str(error) if isinstance(error, UpdateError) else f"interrupted ({type(error).__name__})"
            self._take_back(state, why)
            if isinstance(error, UpdateError):
                raise
            raise UpdateError(f"{why}; {_went_back(before)}") from error
        state["state"] = GOOD
        self._write(state)
        return state

    def back(self, restart: Sequence[str] = ()) -> str:
        """Use the other slot again; returns its name (UpdateError if there is nothing in it)."""
        slot = SLOTS[self.current == SLOTS[0]]
        version = self._version(slot)
        last = self.state()
        units = list(restart) or (last["restart"] if last is not None else [])
        self._point_at(slot)
        self._write(
            State(slot=slot, back_to="", requirement="", version=version, state=GOOD, why="by hand", restart=units)
        )
        self._restart(units)
        return slot

    def recover(self, *, at_boot: bool = False) -> str:
        """Take back an update that was interrupted; returns the slot that is used again, empty if there was none.

        Args:
            at_boot: whether the units are about to be started anyway.

        """
        last = self.state()
        if last is None or last["state"] != TRYING:
            return ""
        self._take_back(
            last, "interrupted: the machine went down before the update was found good", restarts=not at_boot
        )
        return last["back_to"]

    def _fill(self, slot: str, requirement: str, pip_options: Sequence[str]) -> str:
        folder = self.root / slot
        shutil.rmtree(folder, ignore_errors=True)
        venv.EnvBuilder(symlinks=True, with_pip=False).create(folder)
        pip = [sys.executable, "-m", "pip", "--python", str(folder / "bin" / "python"), "install", "--no-input"]
        ran = _run([*pip, "--disable-pip-version-check", "--quiet", *pip_options, requirement], None)
        if ran.returncode:
            raise UpdateError(f"{requirement} cannot be installed: {_last_line(ran)}")
        os.sync()  # what pip has written must be there after a power cut, if the link is
        return self._version(slot)

    def _version(self, slot: str) -> str:
        program = self.root / slot / "bin" / "robrain"
        if not program.exists():
            raise UpdateError(f"slot {slot} has no robrain")
        ran = _run([str(program), "--version"], TRIAL_S)
        if ran.returncode:
            raise UpdateError(f"robrain in slot {slot} does not start: {_last_line(ran)}")
        return ran.stdout.strip()

    def _point_at(self, slot: str) -> None:
        """Change the link in one step: at every instant it names a whole slot."""
        anew = self.root / f"{CURRENT}.new"
        anew.unlink(missing_ok=True)
        anew.symlink_to(slot)
        anew.replace(self.root / CURRENT)
        _sync(self.root)

    def _take_back(self, state: State, why: str, *, restarts: bool = True) -> None:
        if state["back_to"]:
            self._point_at(state["back_to"])
        else:
            (self.root / CURRENT).unlink(missing_ok=True)
        state["state"], state["why"] = BAD, why
        self._write(state)
        if restarts and state["back_to"]:
            self._restart(state["restart"])

    def _restart(self, units: Sequence[str]) -> None:
        if units:
            ran = _run([*self._systemctl, "restart", *units], None)
            if ran.returncode:
                raise UpdateError(f"{' '.join(units)} cannot be restarted: {_last_line(ran)}")

    def _until_healthy(self, slot: str, health: str, health_s: float) -> None:
        if not health:
            return
        path = f"{self.root / slot / 'bin'}{os.pathsep}{os.environ.get('PATH', os.defpath)}"
        deadline_s = time.monotonic() + health_s
        while True:
            ran = _run(shlex.split(health), max(deadline_s - time.monotonic(), PAUSE_S), {**os.environ, "PATH": path})
            if not ran.returncode:
                return
            if time.monotonic() + PAUSE_S > deadline_s:
                raise UpdateError(f"not healthy after {health_s:g} s, so it was taken back: {_last_line(ran)}")
            time.sleep(PAUSE_S)

    def _write(self, state: State) -> None:
        anew = self.root / f"{STATE}.new"
        with anew.open("w", encoding="utf-8") as file:
            json.dump(state, file, indent=1)
            file.flush()
            os.fsync(file.fileno())
        anew.replace(self.root / STATE)
        _sync(self.root)


def _run(
    command: list[str], timeout_s: float | None, environment: dict[str, str] | None = None
) -> "subprocess.CompletedProcess[str]":
    try:
        return subprocess.run(
            command,
            capture_output=True,
            text=True,
            check=False,
            timeout=timeout_s,
            env=environment,
            stdin=subprocess.DEVNULL,
        )
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(command, EXIT_FAILED, "", f"{command[0]} took longer than {timeout_s:g} s")
    except OSError as error:
        return subprocess.CompletedProcess(command, EXIT_FAILED, "", str(error))


def _last_line(ran: "subprocess.CompletedProcess[str]") -> str:
    lines = [line for line in (ran.stdout + ran.stderr).splitlines() if line.strip()]
    return lines[-1] if lines else f"exit status {ran.returncode}"


def _sync(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _went_back(before: str) -> str:
    return f"slot {before} is in use again" if before else "no version is in use"


def _arguments(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="robrain-update", description="Update robrain, and take updates back.")
    parser.add_argument("--root", type=Path, default=Path("/opt/robrain"), help="folder of the slots")
    commands = parser.add_subparsers(dest="command", required=True)
    install = commands.add_parser("install", help="install a version into the other slot and use it")
    install.add_argument("requirement", help="as pip takes it, such as robrain[navigation]==0.2.0")
    install.add_argument("--pip", default="", help="options of pip install, as one text")
    install.add_argument("--health", default="", help="command that ends with 0 when all is well")
    install.add_argument("--health-s", type=float, default=HEALTH_S, help="how long that may take")
    for command in (install, commands.add_parser("back", help="use the other slot again")):
        command.add_argument("--restart", action="append", default=[], help="unit to restart; may be repeated")
    recover = commands.add_parser("recover", help="take back an update that was interrupted")
    recover.add_argument("--at-boot", action="store_true", help="restart no units: they are started afterwards")
    commands.add_parser("status", help="print the slot in use and the last update as JSON")
    return parser.parse_args(words)


def main(words: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status: 1 if an update was not made or taken back."""
    given = _arguments(words)
    for number in (signal.SIGTERM, signal.SIGHUP):  # as Ctrl-C: the update is taken back
        signal.signal(number, _interrupt)
    machine = Machine(given.root, shlex.split(os.environ.get("ROBRAIN_SYSTEMCTL", "systemctl")))
    try:
        if given.command == "status":
            said = json.dumps({"current": machine.current, "last": machine.state()})
        else:
            with machine.alone():
                said = _do(machine, given)
    except (UpdateError, OSError) as error:
        sys.stderr.write(f"robrain-update: {error}\n")
        return EXIT_FAILED
    sys.stdout.write(f"{said}\n")
    return 0


def _interrupt(number: int, _frame: object) -> None:
    raise KeyboardInterrupt(signal.Signals(number).name)


def _do(machine: Machine, given: argparse.Namespace) -> str:
    if given.command == "recover":
        slot = machine.recover(at_boot=given.at_boot)
        return f"slot {slot} is in use again" if slot else "nothing to take back"
    if given.command == "back":
        return f"slot {machine.back(given.restart)} is in use again"
    options = shlex.split(given.pip)
    state = machine.install(given.requirement, options, given.restart, given.health, given.health_s)
    return f"{state['version']} is in use, in slot {state['slot']}; robrain-update back takes it back"


if __name__ == "__main__":
    sys.exit(main())
