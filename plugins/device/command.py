"""Command: the link between the plugins that can be seen from outside and those that connect to the outside."""

from typing import Protocol

from robrain.agent.environment import CommandDoor
from robrain.agent.plugin import Device, unlocked
from robrain.protocol.errors import CallError, ErrorCode


class CommandInterface(Protocol):
    """The robot's plugins as those outside see them. Both may be called from any thread."""

    def execute(self, text: str) -> str:
        """Execute one command of the text form.

        Returns:
            `ok`, `ok RESULT`, or `error CODE: MESSAGE` with a code of `ErrorCode`; `help` has several lines.

        """

    def plugins(self) -> str:
        """Names of the plugins that are open to the outside, with blanks between them."""


class Command(Device):
    """Executes the text form, such as `call driver stop()`, for plugins that serve the outside."""

    interface = CommandInterface

    # The called code holds its own locks: a lock held here meanwhile could end in a deadlock.

    @unlocked
    def execute(self, text: str) -> str:
        try:
            result = self._door().call_text(text)
        except CallError as error:
            return f"error {error.code}: {error.message}"
        except Exception as error:  # noqa: BLE001 - foreign plugin code; its error is the answer
            return f"error {ErrorCode.FAILED}: {type(error).__name__}: {error}"
        return f"ok {result}" if result else "ok"

    @unlocked
    def plugins(self) -> str:
        return " ".join(plugin.name for plugin in self._door().plugins())

    def _door(self) -> CommandDoor:
        door = self.env.outside
        if door is None:
            raise CallError(ErrorCode.FORBIDDEN, f"{self.env.plugin}: only the plugin named command may use the others")
        return door
