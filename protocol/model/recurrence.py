"""Times of a recurrence rule of RFC 5545."""

from collections.abc import Iterator
from datetime import datetime, timedelta
from typing import Annotated, Any
from zoneinfo import ZoneInfo

from msgspec import Meta

from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import Text

NS_PER_S = 1_000_000_000
STEPS = {"MINUTELY": timedelta(minutes=1), "HOURLY": timedelta(hours=1)}
"""Step of frequencies with many occurrences a day."""
BACK = timedelta(days=8)
"""Their occurrences are counted from this long before the start."""
FREQUENCIES = (*STEPS, "DAILY", "WEEKLY", "MONTHLY", "YEARLY")


class Recurrence(Checked, frozen=True, kw_only=True):
    """Times that a rule of a calendar gives."""

    rrule: Text
    """Recurrence rule of RFC 5545, such as `FREQ=WEEKLY;BYDAY=MO,FR;BYHOUR=8;BYMINUTE=0`; no `FREQ=SECONDLY`."""
    begins: Text = ""
    """First occurrence (DTSTART), local time, such as `2026-12-01T08:00:00`. Default: midnight before the start."""
    time_zone: Text = "UTC"
    """IANA name of the zone of all local times, such as `Europe/Berlin`."""
    except_dates: Annotated[tuple[Text, ...], Meta(max_length=1000)] = ()
    """Occurrences that are left out (EXDATE), local times."""

    def __post_init__(self) -> None:
        super().__post_init__()
        Occurrences(self, 0)


class Occurrences:
    """The occurrences of a recurrence, in order.

    Args:
        condition: the recurrence.
        now_ns: the time of the start.

    Raises:
        ValueError: its rule, a date or the time zone is not valid.

    """

    def __init__(self, condition: Recurrence, now_ns: int) -> None:
        from dateutil.rrule import rrulestr  # a team without schedules does without it

        try:
            self._zone = ZoneInfo(condition.time_zone)
        except (KeyError, ValueError, OSError) as error:
            raise ValueError(f"expected time_zone as an IANA name, got {condition.time_zone}") from error
        fields = dict(part.partition("=")[::2] for part in condition.rrule.upper().split(";"))
        frequency, interval = fields.get("FREQ", ""), fields.get("INTERVAL", "1")
        if frequency not in FREQUENCIES or not interval.isdecimal() or not 1 <= int(interval) <= 10_000:
            expected = f"FREQ of {', '.join(FREQUENCIES)} and INTERVAL from 1 to 10000"
            raise ValueError(f"expected rrule with {expected}, got {condition.rrule}")
        now = datetime.fromtimestamp(now_ns / NS_PER_S, self._zone).replace(tzinfo=None)
        begins = (
            _local(condition.begins) if condition.begins else now.replace(hour=0, minute=0, second=0, microsecond=0)
        )
        if frequency in STEPS and "COUNT" not in fields:
            step = STEPS[frequency] * int(interval)
            begins += max(0, (now - BACK - begins) // step) * step
        try:
            rule: Any = rrulestr(condition.rrule, dtstart=begins)
            self._left: Iterator[datetime] = iter(rule)
        except (ValueError, TypeError) as error:
            raise ValueError(f"expected rrule as in RFC 5545, got {condition.rrule}: {error}") from error
        self._left_out = {_local(date) for date in condition.except_dates}
        self.next_ns: int | None = 0
        """The next one; None after the last."""
        self._advance()

    def latest_ns(self, now_ns: int) -> int | None:
        """The last new occurrence up to now; None if there is none."""
        found = None
        while self.next_ns is not None and self.next_ns <= now_ns:
            found = self.next_ns
            self._advance()
        return found

    def text_of(self, occurrence_ns: int) -> str:
        """Local time of an occurrence."""
        return f"{datetime.fromtimestamp(occurrence_ns / NS_PER_S, self._zone):%Y-%m-%d %H:%M:%S}"

    def _advance(self) -> None:
        for local in self._left:
            if local not in self._left_out:
                self.next_ns = round(NS_PER_S * local.replace(tzinfo=self._zone).timestamp())
                return
        self.next_ns = None


def _local(text: str) -> datetime:
    try:
        found = datetime.fromisoformat(text)
    except ValueError as error:
        raise ValueError(f"expected a local time such as 2026-12-01T08:00:00, got {text}") from error
    if found.tzinfo is not None:
        raise ValueError(f"expected a local time without an offset, got {text}; use time_zone")
    return found
