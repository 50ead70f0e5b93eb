"""Interactive shell: the text form at a terminal of the robot itself; `robrain shell ROBOT` is the one from afar."""

import os
import selectors
import socket
from collections.abc import Callable

import msgspec

from robrain.agent.errors import HardwareAbsent, PluginError
from robrain.agent.plugin import Unit
from robrain.plugins.device.command import CommandInterface
from robrain.protocol.wire.endpoint import Drive
from robrain.protocol.workers import OwnedThread

READ_BYTES = 4096
CLOSE_TIMEOUT_S = 2.0


class Terminal:
    """Reads commands from a terminal and writes the answers there, until `close` or the terminal's end.

    Args:
        path: the terminal's device.
        prompt: stands before each command.
        execute: answers one command; called on the terminal's thread.

    Raises:
        OSError: the terminal cannot be opened.

    """

    def __init__(self, path: str, prompt: str, execute: Callable[[str], str]) -> None:
        self._execute = execute
        self._prompt = prompt
        self._terminal = os.open(path, os.O_RDWR | os.O_NOCTTY)
        self._woken, self._wake = socket.socketpair()
        self._thread = OwnedThread(f"terminal-{path}", self._run)

    def close(self) -> None:
        """Stop reading; a command that takes too long is abandoned."""
        self._wake.close()
        self._thread.close(CLOSE_TIMEOUT_S)

    def _run(self) -> None:
        with self._woken, selectors.DefaultSelector() as selector:
            selector.register(self._terminal, selectors.EVENT_READ)
            selector.register(self._woken, selectors.EVENT_READ)
            try:
                self._write(self._prompt)
                while self._woken not in [key.fileobj for key, _ in selector.select()]:
                    # A terminal gives a line at a time, at most READ_BYTES of it.
                    line = os.read(self._terminal, READ_BYTES)
                    if not line:
                        return
                    text = line.decode(errors="replace").strip()
                    self._write((f"{self._execute(text)}\n" if text else "") + self._prompt)
            except OSError:
                return  # the terminal was closed
            finally:
                os.close(self._terminal)

    def _write(self, text: str) -> None:
        rest = text.encode(errors="backslashreplace")
        while rest:
            rest = rest[os.write(self._terminal, rest) :]


class InteractiveShell(Unit):
    """Lets a person at the robot's own terminal call its plugins."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """Which terminal."""

        enabled: bool = False
        """Off by default: an agent usually runs as a service, without a terminal."""
        terminal: str = "/dev/tty"
        """Device of the terminal: `/dev/tty` is the terminal that started the agent, `/dev/ttyS0` a serial line."""

    parameters: Parameters

    def init(self) -> None:
        self._terminal: Terminal | None = None

    def activate(self) -> None:
        command = self.env.use("command", CommandInterface)
        if not self.parameters.enabled:
            return
        if self.env.wire.drive is Drive.LOCKSTEP:
            raise PluginError(
                self.env.plugin, f"{self.env.plugin} runs only in the live drive: a lockstep run has one thread"
            )
        try:
            self._terminal = Terminal(self.parameters.terminal, f"{self.env.robot}> ", command.execute)
        except OSError as error:
            raise HardwareAbsent(
                self.env.plugin, f"no terminal at {self.parameters.terminal}: {error.strerror}"
            ) from error

    def deactivate(self) -> None:
        terminal, self._terminal = self._terminal, None
        if terminal is not None:
            terminal.close()
