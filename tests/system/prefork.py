"""`robrain` commands forked from a process that has imported everything and loaded the kernels.

A command starts in 30 ms instead of a second and a half, most of which is numba, scipy and the kernels. It is a process
of its own all the same: own arguments, environment, folder, output, threads and Zenoh session. What a new interpreter
does is tested by the processes that `robrain up` starts, and by all tests that set a variable of Python's.

Run as `python -m tests.system.prefork`, this is the server: it reads a request from file descriptor 0, which is a Unix
socket, forks, answers with the process id, and later with the exit status.
"""

import atexit
import ctypes
import gc
import importlib
import json
import os
import pkgutil
import selectors
import signal
import socket
import subprocess
import sys
import threading
import traceback
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

ROOT = Path(__file__).parents[2]
MAX_REQUEST_BYTES = 1 << 20
PR_SET_PDEATHSIG = 1  # of linux/prctl.h
OWN_INTERPRETER = ("PYTHON", "OPENBLAS", "NUMBA", "OMP")
"""A command with a variable of these names gets a new interpreter."""


class PreforkServer:
    """Starts the server when it is first needed, and ends it.

    Args:
        variables: of the server's interpreter, in which packages may be missing then.

    """

    def __init__(self, **variables: str) -> None:
        self._variables = variables
        self._process: subprocess.Popen[bytes] | None = None
        self._socket: socket.socket | None = None

    def request(self, what: Mapping[str, Any], files: Sequence[int]) -> socket.socket:
        """Ask for one process; returns a socket that tells its process id, and then its exit status."""
        if self._socket is None:
            ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            with theirs:
                self._process = subprocess.Popen(
                    [sys.executable, "-m", __name__, *(["--missing"] if self._variables else [])],
                    stdin=theirs,
                    stdout=subprocess.DEVNULL,
                    cwd=ROOT,
                    env={**os.environ, **self._variables},
                )
            self._socket = ours
        told, tells = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        with tells:
            socket.send_fds(self._socket, [json.dumps(what).encode()], [*files, tells.fileno()])
        return told

    def close(self) -> None:
        """End it, and with it the commands that still run."""
        if self._socket is not None and self._process is not None:
            self._socket.close()
            self._process.wait()


class ForkedCommand(subprocess.Popen[str]):
    """Popen of `robrain WORDS`, which is forked from the server and needs no new interpreter.

    Popen makes the pipes; the three methods that know how a process begins and ends are replaced.
    """

    def __init__(self, server: PreforkServer, words: Sequence[str], **options: Any) -> None:
        self._server = server
        super().__init__(["robrain", *words], text=True, **options)

    def _execute_child(self, args: Sequence[str], *rest: Any) -> None:
        _, _, _, _, cwd, env, _, _, _, stdin, to_stdin, from_stdout, stdout, from_stderr, stderr, *_, session, _ = rest
        ours = (to_stdin, from_stdout, from_stderr)
        null = os.open(os.devnull, os.O_RDWR)
        try:
            files = [stdin if stdin != -1 else null, stdout if stdout != -1 else 1, stderr if stderr != -1 else 2]
            what = {"words": args[1:], "folder": str(cwd), "variables": dict(env), "session": session}
            self._told = self._server.request(what, files)
        finally:
            given = [theirs for own, theirs in zip(ours, (stdin, stdout, stderr), strict=True) if own != -1]
            for file in {null, *given, getattr(self, "_devnull", null)}:  # as Popen does after it has forked
                os.close(file)
        self.pid = int.from_bytes(self._told.recv(4), "little")
        self._child_created = True
        if not self.pid:
            self._told.close()
            self.returncode = 1
            raise ChildProcessError("the server of forked commands has ended")

    def _try_wait(self, wait_flags: int) -> tuple[int, int]:
        try:
            told = self._told.recv(4, socket.MSG_DONTWAIT if wait_flags & os.WNOHANG else 0)
        except BlockingIOError:
            return 0, 0
        self._told.close()
        return self.pid, int.from_bytes(told, "little") if told else signal.SIGKILL

    def _internal_poll(self, _deadstate: int | None = None) -> int | None:
        if self.returncode is None and hasattr(self, "_told"):
            pid, status = self._try_wait(os.WNOHANG)
            if pid:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode


def _serve() -> None:
    """Fork a command for each request until the other end closes; returns in the commands only."""
    requests = socket.socket(fileno=os.dup(0))
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    signal.set_wakeup_fd(writer)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    running: dict[int, socket.socket] = {}
    with selectors.DefaultSelector() as selector:
        selector.register(requests, selectors.EVENT_READ)
        selector.register(reader, selectors.EVENT_READ)
        while True:
            for key, _ in selector.select():
                if key.fileobj is requests:
                    message, files, _, _ = socket.recv_fds(requests, MAX_REQUEST_BYTES, 4)
                    if not message:
                        os._exit(0)
                    pid = os.fork()
                    if pid == 0:
                        signal.set_wakeup_fd(-1)
                        for own in (reader, writer, files[3], *(one.fileno() for one in running.values())):
                            os.close(own)
                        requests.close()
                        _become(json.loads(message), files)
                        return
                    tells = socket.socket(fileno=files.pop())
                    for file in files:
                        os.close(file)
                    tells.sendall(pid.to_bytes(4, "little"))
                    running[pid] = tells
                else:
                    os.read(reader, 4096)
            while running:
                pid, status = os.waitpid(-1, os.WNOHANG)
                if not pid:
                    break
                with running.pop(pid) as tells, suppress(BrokenPipeError):  # the test may have ended
                    tells.sendall(status.to_bytes(4, "little"))


def end_with_parent() -> None:
    """Have this process end with the one that started it, such as tests that are interrupted."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


def _become(what: dict[str, Any], files: list[int]) -> None:
    """Take the place of the command: session, files, folder, variables and arguments."""
    end_with_parent()
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if what["session"]:
        os.setsid()
    for number, file in enumerate(files[:3]):
        os.dup2(file, number)
    for file in files[:3]:
        os.close(file)
    os.chdir(what["folder"])
    os.environ.clear()
    os.environ.update(what["variables"])
    sys.argv = [str(ROOT / "robrain" / "cli.py"), *what["words"]]
    main = sys.modules["__main__"]
    main.__package__ = "robrain"  # so that help names `python -m robrain.cli`
    main.__spec__ = main.__file__ = None  # so that processes which multiprocessing spawns do not import this server


def import_everything(missing: tuple[type[Exception], ...] = ()) -> None:
    """Import what commands use, and load the kernels.

    Args:
        missing: errors that a module may raise when it is imported.

    """
    for name in ("cli", "agent.host.live_drive", "coordinator.live", "dashboard.server.server"):
        with suppress(*missing):
            importlib.import_module(f"robrain.{name}")
    for package in ("robrain.deploy", "robrain.lab"):
        for module in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
            # Processes that are forked with rclpy loaded abort at their end: "exception not rethrown".
            if "bench" not in module.name and "rclpy" not in module.name:
                with suppress(*missing):
                    importlib.import_module(module.name)
    importlib.import_module("robrain.cli").all_commands()
    with suppress(*missing):
        importlib.import_module("robrain.deploy.processes.kernels").prepare_kernels(quiet=True)


def _main() -> NoReturn:
    import_everything(missing=(ModuleNotFoundError,) if sys.argv[1:] else ())
    gc.freeze()  # what is there is shared by all commands
    _serve()
    _end(run_main())


def run_main() -> int:
    """Run the command of `sys.argv` in this process; returns its exit status."""
    from robrain.cli import main

    try:
        main()
    except SystemExit as ended:
        if ended.code is None or isinstance(ended.code, int):
            return ended.code or 0
        sys.stderr.write(f"{ended.code}\n")
        return 1
    except BaseException:  # noqa: BLE001 - the interpreter prints what nobody catches
        traceback.print_exc()
        return 1
    return 0


def _end(status: int) -> NoReturn:
    """End as an interpreter does, but free no object: that copies each page which the server shares, for 0.5 s."""
    threading._shutdown()  # type: ignore[attr-defined]  # waits for threads that are no daemons
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            status = 120  # as Python's
    os._exit(status)


if __name__ == "__main__":
    _main()
