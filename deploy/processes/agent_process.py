"""`robrain agent`: one robot. Needs the plain install only."""

import os
import re
import sys
import time
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import NamedTuple

import msgspec

from robrain.agent.consensus.witness import Kept, WitnessExtension
from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.live_drive import run_agent
from robrain.agent.host.robot_file import TlsTable, ZenohTable, folder_of, read_robot_file
from robrain.agent.host.robot_log import plugin_here
from robrain.agent.lifecycle.registry import plugin_faults
from robrain.deploy.command_line.output import print_message, print_result
from robrain.deploy.processes.live_process import (
    LiveStop,
    check_certificate,
    check_rights,
    open_when_there,
    warn_of_listening,
)
from robrain.deploy.processes.name_claim import NameWatcher, claim_robot
from robrain.deploy.processes.process_setup import CONTEXT, limit_zenoh_threads
from robrain.protocol.access.identity import TLS_VARIABLE
from robrain.protocol.access.member import MemberRole
from robrain.protocol.clock import LiveClock
from robrain.protocol.keys import check_name
from robrain.protocol.state_folder import state_folder
from robrain.protocol.wire.endpoint import Drive
from robrain.protocol.wire.hub import given_endpoints, team_endpoints
from robrain.protocol.wire.session import listening_at

STATE_VARIABLE = "STATE_DIRECTORY"
"""Set by systemd for a unit with `StateDirectory=`; several folders are separated by colons."""


def witness_path(team: str, robot: str, votes: Path | None = None) -> Path:
    """The file of a robot's votes: in `votes`, else in the unit's state folder, else in the user's."""
    folder = os.environ.get(STATE_VARIABLE, "").partition(":")[0]
    return (votes or (Path(folder) if folder else state_folder())) / f"witness-{team}-{robot}.json"


class WitnessFile:
    """Stores it in a file, which is replaced as a whole.

    Args:
        path: of the file; made, with its folder, by the first answer.

    """

    def __init__(self, path: Path) -> None:
        self._path = path

    def read(self) -> Kept:
        """Values that were stored last; empty if there is no file (OSError, ValueError)."""
        try:
            data = self._path.read_bytes()
        except FileNotFoundError:
            return Kept()
        try:
            return msgspec.json.decode(data, type=Kept)
        except msgspec.MsgspecError as error:
            raise ValueError(f"{self._path}: {error}; if no coordinator was ever elected, remove it") from error

    def write(self, kept: Kept) -> None:
        """Replace the file, on the disk when this returns (OSError)."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        new = self._path.with_name(f"{self._path.name}.new")
        with new.open("wb") as file:
            file.write(msgspec.json.encode(kept))
            file.flush()
            os.fsync(file.fileno())
        new.replace(self._path)
        descriptor = os.open(self._path.parent, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def agent_command(robot: Path, connect: str | None, team: str | None, votes: Path | None = None) -> None:
    """Run one robot until Ctrl-C; wait until its endpoint answers.

    Args:
        robot: its ROBOT.toml.
        connect: endpoint of the team; None uses the file's, else $ROBRAIN_CONNECT, else this machine's hub.
        team: its name; None uses the file's.
        votes: folder for its votes; None chooses one.

    Raises:
        RobrainError: in one sentence.

    """
    limit_zenoh_threads()
    robot_file = read_robot_file(robot)
    table, settings = robot_file.robot, robot_file.zenoh
    if team is not None:
        table = msgspec.structs.replace(table, team=check_name("team", team))
    where = endpoints_of(settings, connect)
    if isinstance(settings.tls, TlsTable):  # for plugins in separate processes as well
        os.environ[TLS_VARIABLE] = str(folder_of(robot.parent, settings.tls.folder).resolve())
    warn_of_listening("agent", settings.listen, print_message)
    identity = check_certificate("agent", print_message, where, table.team, MemberRole.ROBOT, table.name)
    should_stop = LiveStop()
    session = open_when_there("agent", where, should_stop, mode=settings.mode, listen=settings.listen)
    if session is None:
        return
    if identity is not None:
        check_rights("agent", print_message, session, where, identity)
    with closing(session), claim_robot(session, table.team, table.name) as claim:
        if not claim.acquire(lambda text: print_message(f"agent: {text}"), should_stop):
            return
        # Plugins in separate processes connect to the robot's endpoint, or to the robot itself if it has none.
        zenoh = msgspec.structs.replace(settings, connect=where or listening_at(session))
        robot_file = msgspec.structs.replace(robot_file, robot=table, zenoh=zenoh)
        witness = partial(WitnessExtension, memory=WitnessFile(witness_path(table.team, table.name, votes)))
        host = AgentHost(robot_file, robot.parent, session, LiveClock(), Drive.LIVE, extensions={"witness": witness})
        CONTEXT.robot, CONTEXT.plugin, CONTEXT.task = host.name, plugin_here, host.task_id

        def report_plugins() -> None:
            claim.settle()
            plugins = host.manager.plugins
            should_stop.ready()
            running = sum(plugin.state.is_running for plugin in plugins.values())
            print_result(f"agent: {host.name} is up with {running} plugins")
            uninstalled: dict[str, list[str]] = {}
            for fault in plugin_faults(host.manager.registry):
                if needed := plugins[fault.plugin].needs:
                    uninstalled.setdefault(needed, []).extend([fault.plugin, *fault.dependants])
                else:
                    print_result(f"agent: {host.name}: {fault.words}")
            for needed, names in uninstalled.items():
                print_result(f"agent: {host.name} without {', '.join(dict.fromkeys(names))}: pip install '{needed}'")

        watch, compiler, began_s = NameWatcher(claim, should_stop), CompilerPages(), time.monotonic()

        def watch_and_tidy() -> bool:
            compiler.give_back(time.monotonic() - began_s)
            output.report_dropped()
            return watch()

        with host.log.plugin_output() as output:
            run_agent(host, watch_and_tidy, report_plugins)
        watch.check()


def endpoints_of(settings: ZenohTable, connect: str | None) -> list[str]:
    """Endpoints of a robot: those of the command line, else of its file, else $ROBRAIN_CONNECT or the hub."""
    if connect is not None:
        return given_endpoints(connect)
    if settings.connect or settings.listen:
        return settings.connect
    return team_endpoints() if settings.mode == "client" else given_endpoints(None)


LIBRARY = "libllvmlite"
PERIOD_S = 5.0
MADV_DONTNEED = 4
_MAPPING = re.compile(r"(?P<begin>[0-9a-f]+)-(?P<end>[0-9a-f]+) (?P<rights>\S+) \S+ \S+ \S+ +(?P<file>.+)")


class Pages(NamedTuple):
    """A range of addresses."""

    begin: int
    size: int


def unchanged_pages(smaps: str, library: str) -> list[Pages]:
    """Pages that a process has mapped of a library and has not changed; they can be read again from its file.

    Args:
        smaps: text of `/proc/PID/smaps`.
        library: beginning of the name of its file.

    """
    found: list[Pages] = []
    pages: Pages | None = None
    for line in smaps.splitlines():
        mapping = _MAPPING.fullmatch(line)
        if mapping is not None:
            begin, end = int(mapping["begin"], 16), int(mapping["end"], 16)
            is_its = Path(mapping["file"]).name.startswith(library) and "w" not in mapping["rights"]
            pages = Pages(begin, end - begin) if is_its else None
        elif line.startswith("Anonymous:") and pages is not None and line.split()[1] == "0":
            found.append(pages)  # pages that the loader has changed are private copies, and would be lost
    return found


class CompilerPages:
    """Returns the pages to the kernel every few seconds, on Linux; elsewhere it has no effect."""

    def __init__(self) -> None:
        self._pages: list[Pages] = []
        self._due_s = PERIOD_S

    def give_back(self, now_s: float) -> None:
        """Do so if it is time.

        Args:
            now_s: since the process became alive.

        """
        if now_s < self._due_s:
            return
        self._due_s = now_s + PERIOD_S
        if not self._pages and "llvmlite.binding" in sys.modules and sys.platform == "linux":
            self._pages = unchanged_pages(Path("/proc/self/smaps").read_text(encoding="utf-8"), LIBRARY)
        if self._pages:
            import ctypes  # llvmlite has loaded it

            libc = ctypes.CDLL(None)
            libc.madvise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
            for pages in self._pages:
                libc.madvise(pages.begin, pages.size, MADV_DONTNEED)
