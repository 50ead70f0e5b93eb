"""What the sensor board offers."""

from typing import Protocol

import msgspec


class Sensed(msgspec.Struct, frozen=True, kw_only=True):
    """What was measured where the robot is; names as in `MoteReading`, with the unit."""

    values: dict[str, float]
    stamp_ns: int


class SensorBoardInterface(Protocol):
    """Measures what motes measure, when asked."""

    def measure(self) -> Sensed:
        """Measure now.

        Raises:
            CallError: the board does not answer; the text says why.

        """
