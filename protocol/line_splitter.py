"""Splits a stream of bytes into lines."""


class LineSplitter:
    """Splits bytes into lines that end with a line feed; it never holds more than one line of the greatest length.

    Args:
        max_bytes: longer lines are skipped.
        skips_first: skip the first line as well, which may have begun before the stream was opened.

    """

    def __init__(self, max_bytes: int, *, skips_first: bool = False) -> None:
        self._max_bytes, self._skips = max_bytes, skips_first
        self._begun = bytearray()

    @property
    def has_begun(self) -> bool:
        """Whether a line has begun that has not ended."""
        return bool(self._begun)

    def feed(self, data: bytes) -> list[bytes | None]:
        """The lines that end in these bytes, without their ends; None stands for each that is too long."""
        lines: list[bytes | None] = []
        *ended, rest = data.split(b"\n")
        for part in ended:
            self._begin(part, lines)
            if not self._skips:
                line = bytes(self._begun).removesuffix(b"\r")
                lines.append(line if len(line) <= self._max_bytes else None)
            self._begun.clear()
            self._skips = False
        self._begin(rest, lines)
        return lines

    def _begin(self, part: bytes, lines: list[bytes | None]) -> None:
        if self._skips:
            return
        self._begun += part
        if len(self._begun) > self._max_bytes + 1:  # a carriage return may belong to its end
            self._begun.clear()
            self._skips = True
            lines.append(None)
