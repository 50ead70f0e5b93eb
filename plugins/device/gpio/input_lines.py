"""Input lines of a GPIO chip, by libgpiod."""

from collections.abc import Sequence
from datetime import timedelta
from enum import StrEnum
from typing import Annotated

import gpiod
from gpiod.line import Bias, Direction, Value
from msgspec import Meta

LineName = Annotated[int, Meta(ge=0, le=1023)] | Annotated[str, Meta(min_length=1, max_length=64)]
"""Offset of a line in its chip, or its name, such as `GPIO17`."""
ChipPath = Annotated[str, Meta(min_length=1, max_length=4096)]
DEBOUNCE_S_MAX = 0.1


class Pull(StrEnum):
    """The chip's own resistor, which says what an open line reads as."""

    UP = "up"
    DOWN = "down"
    NONE = "none"
    """A resistor on the board does."""


_BIASES = {Pull.UP: Bias.PULL_UP, Pull.DOWN: Bias.PULL_DOWN, Pull.NONE: Bias.DISABLED}


class GpioAbsent(OSError):
    """Lines that cannot be opened or read. A fault like others: the plugin is started again later."""


class InputLines:
    """Some lines of one chip.

    Args:
        chip: path of its device file, such as `/dev/gpiochip0`.
        lines: which, in the order of `read`.
        pull: the resistor on all of them.
        is_low_active: whether `read` is true for a low level.
        debounce_s: changes that last less are not seen; 0 for all.
        consumer: who uses them, as `gpioinfo` shows it.

    """

    def __init__(
        self,
        chip: str,
        lines: Sequence[int | str],
        pull: Pull,
        *,
        is_low_active: bool,
        debounce_s: float,
        consumer: str,
    ) -> None:
        self._chip, self._lines, self._consumer = chip, tuple(lines), consumer
        self._settings = gpiod.LineSettings(
            direction=Direction.INPUT,
            bias=_BIASES[pull],
            active_low=is_low_active,
            debounce_period=timedelta(seconds=debounce_s),
        )
        self._request: gpiod.LineRequest | None = None

    @property
    def where(self) -> str:
        """Such as `lines 17, 27 of /dev/gpiochip0`."""
        return f"line{'s' if len(self._lines) > 1 else ''} {', '.join(map(str, self._lines))} of {self._chip}"

    @property
    def is_open(self) -> bool:
        """Whether they are."""
        return self._request is not None

    def open(self) -> None:
        """Request the lines (GpioAbsent, naming them: there are none, or another program uses them)."""
        try:
            self._request = gpiod.request_lines(self._chip, {self._lines: self._settings}, consumer=self._consumer)
        except (OSError, ValueError) as error:  # ValueError: the chip has no line of that name
            raise GpioAbsent(f"cannot open {self.where}: {error}") from error

    def read(self) -> list[bool]:
        """Which lines are active (GpioAbsent, naming them)."""
        if self._request is None:
            raise GpioAbsent(f"{self.where} are not open")
        try:
            return [value is Value.ACTIVE for value in self._request.get_values()]
        except (OSError, gpiod.RequestReleasedError) as error:
            raise GpioAbsent(f"cannot read {self.where}: {error}") from error

    def close(self) -> None:
        """Give the lines back."""
        if self._request is not None:
            request, self._request = self._request, None
            try:
                request.release()
            except OSError:  # the chip has gone, and its lines with it
                return
