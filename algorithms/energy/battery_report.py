"""Reports of batteries beside their measurements."""

import msgspec


class BatteryReport(msgspec.Struct, frozen=True, kw_only=True):
    """Charge that a battery reports, and whether it measures its current."""

    has_current: bool = True
    """False: nothing measures the current, and that of the measurement is a guess."""
    soc: float | None = None
    """State of charge that the battery has found itself, 0 to 1, of its full charge as it is now; None if none."""
    soc_sd: float = 0.03
    """Standard deviation of that, above 0."""

    @property
    def is_plain(self) -> bool:
        """Whether the current is measured, and the charge follows from it and the voltage."""
        return self.has_current and self.soc is None


NOTHING_MORE = BatteryReport()
