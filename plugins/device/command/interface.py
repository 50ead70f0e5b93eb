"""What command offers."""

from typing import Protocol


class CommandInterface(Protocol):
    """The robot's plugins as those outside see them. Both may be called from any thread."""

    def execute(self, text: str) -> str:
        """Execute one command of the text form.

        Returns:
            `ok`, `ok RESULT`, or `error CODE: MESSAGE` with a code of `ErrorCode`; `help` has several lines.

        """

    def plugins(self) -> str:
        """Names of the plugins that are open to the outside, with blanks between them."""
