"""What a line to a base station does, whatever it is made of."""

from typing import Protocol

from robrain.protocol.clock import NS_PER_S, to_ns


class LineAbsent(OSError):
    """The base station, or what it hangs on, is not there. A fault like others: the plugin is started again later."""


class PacketLink(Protocol):
    """Carries whole packets. It never waits: it is called in the device's step."""

    @property
    def dropped(self) -> int:
        """Packets that came while too many waited already."""

    def receive(self, now_ns: int) -> list[bytes]:
        """Packets that have arrived; also where a lost line is sought again."""

    def send(self, packet: bytes, now_ns: int) -> None:
        """Hand a packet on; one that the line cannot take is counted."""

    def why_down(self) -> str:
        """Why the line is lost; empty while it is not."""

    def counters(self) -> dict[str, int]:
        """What this kind of line counts."""

    def close(self) -> None:
        """Let go of it."""


class Backoff:
    """When to try again: each failure doubles the wait, up to a limit."""

    def __init__(self, first_s: float, longest_s: float) -> None:
        self._first_ns, self._longest_ns = to_ns(first_s), to_ns(longest_s)
        self._wait_ns = self._first_ns
        self._due_ns = 0
        self.tries = 0
        """Failures since it last succeeded."""

    def wait_s(self, now_ns: int) -> float:
        """Until the next try; 0 if it is due."""
        return 0.0 if self.is_due(now_ns) else (self._due_ns - now_ns) / NS_PER_S

    def is_due(self, now_ns: int) -> bool:
        """Whether to try now."""
        return now_ns >= self._due_ns

    def failed(self, now_ns: int) -> None:
        """It failed again."""
        self.tries += 1
        self._due_ns = now_ns + self._wait_ns
        self._wait_ns = min(2 * self._wait_ns, self._longest_ns)

    def succeeded(self) -> None:
        """The next failure is the first one."""
        self.tries = 0
        self._wait_ns = self._first_ns
