"""A battery that is asked: what all of these have in common, whatever is read and over which bus.

A reading that fails is tried again at the next step, with the bus opened again; `battery` goes on by its estimate
meanwhile. After `silent_s` without a reading the device faults, and the manifest's restart policy tries for as long as
it takes.
"""

import msgspec

from robrain.agent.plugin import Device, external, unlocked
from robrain.agent.silence import Silence
from robrain.plugins.device.bm2.counting import BadReading, Reading, counted
from robrain.plugins.device.bm2.interface import BatteryMeasurement, Bm2Interface
from robrain.protocol.clock import NS_PER_S, to_ns
from robrain.protocol.model.ranges import check_positive

GAP_S = 2.0
"""A longer time between two readings is not counted."""


class BatteryAbsent(OSError):
    """Nothing can be read from the battery. A fault like others: the plugin is started again later."""


class ReadCounters(msgspec.Struct, frozen=True):
    """How it went with reading."""

    readings: int
    rejected: int
    """Readings that cannot be believed."""
    failed: int
    """Attempts in which nothing could be read."""
    last_error: str


class PolledBattery(Device):
    """Reads a battery again and again; subclasses open and read it."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """What all of them have in common."""

        silent_s: float = 5.0
        """Time without a reading after which the battery counts as gone."""

        def __post_init__(self) -> None:
            check_positive(self, "silent_s", below=3600.0)

    interface = Bm2Interface
    period_s = 0.2
    parameters: Parameters

    where = "the battery"
    """What is read, such as `the smart battery at /dev/i2c-1, 0x0b`."""

    def open(self) -> None:
        """Open what the battery is read by (OSError if that fails)."""
        raise NotImplementedError

    def close(self) -> None:
        """Close it; harmless if it is not open."""
        raise NotImplementedError

    def read(self) -> Reading:
        """One reading (OSError if that fails, BadReading if it is not plausible)."""
        raise NotImplementedError

    def init(self) -> None:
        self._latest: BatteryMeasurement | None = None
        self._is_open = False
        self._readings = self._rejected = self._failed = 0
        self._last_error = ""

    def activate(self) -> None:
        self._silence = Silence(to_ns(self.parameters.silent_s))
        self._received_ns = self.env.clock.now_ns()
        try:
            self._read_once(self._received_ns)
        except (OSError, BadReading) as error:
            self._record_failure(error)
            self._close()
            raise BatteryAbsent(f"nothing can be read from {self.where}: {self._last_error}") from error

    def step(self) -> None:
        now_ns = self.env.clock.now_ns()
        try:
            self._read_once(now_ns)
        except (OSError, BadReading) as error:
            self._record_failure(error)
            self._check(now_ns)

    def deactivate(self) -> None:
        self._close()

    @external
    @unlocked
    def latest(self) -> BatteryMeasurement | None:
        """The last measurement; null before the first."""
        return self._latest

    @external
    def counters(self) -> ReadCounters:
        """Readings taken, rejected and failed, and the last error."""
        return ReadCounters(self._readings, self._rejected, self._failed, self._last_error)

    def _read_once(self, now_ns: int) -> None:
        if not self._is_open:
            self.open()
            self._is_open = True
        reading = self.read()
        self._readings += 1
        self._received_ns = now_ns
        self._latest = counted(self._latest, now_ns, *reading, gap_s=GAP_S)

    def _record_failure(self, error: OSError | BadReading) -> None:
        self._last_error = getattr(error, "strerror", None) or str(error) or type(error).__name__
        if isinstance(error, BadReading):
            self._rejected += 1
        else:
            self._failed += 1
            self._close()

    def _close(self) -> None:
        if self._is_open:
            self._is_open = False
            self.close()

    def _check(self, now_ns: int) -> None:
        silent_ns = self._silence.since(self._received_ns, now_ns)
        if silent_ns > self._silence.limit_ns:
            silent_s = silent_ns / NS_PER_S
            raise BatteryAbsent(f"nothing read for {silent_s:.1f} s from {self.where}: {self._last_error}")
