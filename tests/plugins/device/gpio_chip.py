"""A GPIO chip with contacts on its lines, behind the functions of gpiod 2 that robrain's devices use.

The kernel's own, `gpio-sim`, needs a module and configfs; this one needs neither.
"""

import errno
from collections.abc import Iterable, Mapping

import gpiod
from gpiod.line import Bias, Direction, Value

Line = int | str


class GpioChip:
    """A chip; `request_lines` replaces gpiod's function.

    Args:
        names: offset of each line that has a name.

    """

    def __init__(self, names: Mapping[str, int] | None = None, lines: int = 32) -> None:
        self.is_there = True
        self.levels: dict[int, bool] = {}
        """Lines that are connected to ground (False) or supply (True), by offset; all others are open."""
        self.consumers: dict[int, str] = {}
        """User of a line."""
        self._names, self._lines = dict(names or {}), lines

    def request_lines(
        self, path: str, config: Mapping[Iterable[Line] | Line, gpiod.LineSettings | None], consumer: str = ""
    ) -> "GpioRequest":
        """As gpiod.request_lines, for inputs.

        Raises:
            OSError: the chip is not there, or a line is in use, or there is no such.
            ValueError: no line has that name.

        """
        if not self.is_there:
            raise FileNotFoundError(errno.ENOENT, "No such file or directory", path)
        settings: dict[int, gpiod.LineSettings] = {}
        for lines, wanted in config.items():
            for line in [lines] if isinstance(lines, int | str) else lines:
                settings[self._offset(line)] = wanted or gpiod.LineSettings()
        if not settings.keys().isdisjoint(self.consumers):
            raise OSError(errno.EBUSY, "Device or resource busy")
        self.consumers |= dict.fromkeys(settings, consumer)
        return GpioRequest(self, settings)

    def _offset(self, line: Line) -> int:
        if isinstance(line, str):
            if line not in self._names:
                raise ValueError(f"no line named '{line}'")
            return self._names[line]
        if line >= self._lines:
            raise OSError(errno.EINVAL, "Invalid argument")
        return line


class GpioRequest:
    """Lines that are in use."""

    def __init__(self, chip: GpioChip, settings: Mapping[int, gpiod.LineSettings]) -> None:
        self._chip = chip
        self._settings: Mapping[int, gpiod.LineSettings] | None = settings
        assert all(each.direction is Direction.INPUT for each in settings.values())

    def get_values(self) -> list[Value]:
        """Logical values, in the order of the request (OSError if the chip has gone)."""
        if self._settings is None:
            raise gpiod.RequestReleasedError
        if not self._chip.is_there:
            raise OSError(errno.ENODEV, "No such device")
        return [
            Value.ACTIVE if self._is_high(offset, each) != each.active_low else Value.INACTIVE
            for offset, each in self._settings.items()
        ]

    def release(self) -> None:
        """Give the lines back."""
        for offset in self._settings or ():
            self._chip.consumers.pop(offset, None)
        self._settings = None

    def _is_high(self, offset: int, settings: gpiod.LineSettings) -> bool:
        return self._chip.levels.get(offset, settings.bias is Bias.PULL_UP)
