"""Interactive shell: the text form at a terminal of the robot itself; `robrain shell ROBOT` is the one from afar."""

import msgspec

from robrain.agent.errors import HardwareAbsent, PluginError
from robrain.agent.plugin import Unit
from robrain.plugins.device.command.interface import CommandInterface
from robrain.plugins.unit.interactive_shell.terminal import Terminal
from robrain.protocol.wire.endpoint import Drive


class InteractiveShell(Unit):
    """Lets a person at the robot's own terminal call its plugins."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """Which terminal."""

        enabled: bool = False
        """Off by default: an agent usually runs as a service, without a terminal."""
        terminal: str = "/dev/tty"
        """Device of the terminal; the one that the agent was started from, or a serial line as `/dev/ttyS0`."""

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
