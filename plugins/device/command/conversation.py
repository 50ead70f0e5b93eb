"""A conversation in lines: bytes come in as they are received, one answer goes out for each line."""

from collections.abc import Callable, Iterator

from robrain.protocol.errors import ErrorCode

MAX_LINE_BYTES = 4096


class Conversation:
    """Turns received bytes into answers.

    A line ends with a line feed, or with carriage return and line feed. One that is too long, or not UTF-8, is
    answered with an error; the rest of it is skipped and the conversation goes on. An answer is always one line:
    breaks within it become ` | `.

    Args:
        execute: answers one command, and never raises.

    """

    def __init__(self, execute: Callable[[str], str]) -> None:
        self._execute = execute
        self._begun = bytearray()
        self._skipping = False

    def take(self, received: bytes) -> Iterator[bytes]:
        """The answers to the lines that end in what was received."""
        *ended, rest = received.split(b"\n")
        for part in ended:
            yield from self._line(part)
        self._begin(rest)
        if len(self._begun) > MAX_LINE_BYTES:
            yield self._too_long()

    def end(self) -> Iterator[bytes]:
        """The answer to a last line that was not ended: it may have been cut, so it is not executed."""
        if self._begun:
            yield _error("the last line has no end, so it was not executed")

    def _begin(self, part: bytes) -> None:
        if not self._skipping:
            self._begun += part

    def _too_long(self) -> bytes:
        self._begun.clear()
        self._skipping = True
        return _error(f"the line is longer than {MAX_LINE_BYTES} bytes")

    def _line(self, part: bytes) -> Iterator[bytes]:
        self._begin(part)
        line = bytes(self._begun).removesuffix(b"\r")
        was_skipping, self._skipping = self._skipping, False
        self._begun.clear()
        if was_skipping:
            return
        if len(line) > MAX_LINE_BYTES:
            yield _error(f"the line is longer than {MAX_LINE_BYTES} bytes")
            return
        try:
            text = line.decode()
        except UnicodeDecodeError as error:
            yield _error(f"the line is not UTF-8 at byte {error.start}")
            return
        yield as_line(self._execute(text))


def as_line(answer: str) -> bytes:
    """An answer as it goes out."""
    one = " | ".join(answer.splitlines())
    return one.encode(errors="backslashreplace") + b"\n"


def _error(message: str) -> bytes:
    return as_line(f"error {ErrorCode.BAD_ARGUMENTS}: {message}")
