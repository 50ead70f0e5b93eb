"""Which of a mote's readings have arrived: its last ones, by their sequence numbers."""

from robrain.protocol.tinyos.payloads import REQUEST_SPAN, SEQUENCES, RequestPayload, SequenceRange, sequences_after

RESTART_BACK = 16
"""A mote whose live readings fall back by more than this has started anew; less is an old packet that comes late."""


class SequenceWindow:
    """Follows one mote's sequence numbers across their wrap.

    Args:
        size: of the last numbers, how many are followed.

    """

    def __init__(self, size: int) -> None:
        self._size = size
        self._newest: int | None = None
        """Without wrap."""
        self._oldest = 0
        """The lowest number that the mote may still have."""
        self._have = 0
        """Bit i: whether `newest` − i has arrived."""
        self.arrived = 0

    @property
    def missing(self) -> int:
        """Readings that the mote may still have and that have not arrived."""
        return self._lacking().bit_count()

    def add(self, sequence: int, *, is_live: bool = True) -> bool:
        """A reading has arrived; whether it is the first time.

        Args:
            sequence: its number, 16 bits.
            is_live: it was just sensed, so none can be newer.

        """
        number = self._number(sequence)
        if self._newest is None or (is_live and number < self._newest - RESTART_BACK):
            self._newest, self._oldest, self._have = sequence, sequence, 1
            self.arrived += 1
            return True
        ahead = number - self._newest
        if ahead > 0:
            self._newest = number
            self._have = ((self._have << ahead) if ahead < self._size else 0) & ((1 << self._size) - 1) | 1
            self._oldest = max(self._oldest, number - self._size + 1)
            self.arrived += 1
            return True
        bit = 1 << -ahead
        if -ahead >= self._size or self._have & bit:
            return False
        self._have |= bit
        self._oldest = min(self._oldest, number)
        self.arrived += 1
        return True

    def mote_holds_from(self, sequence: int) -> None:
        """The mote says which is the oldest reading that it has not got rid of."""
        if self._newest is not None:
            number = min(self._number(sequence), self._newest)
            self._oldest = max(number, self._newest - self._size + 1)

    def request(self, span: int) -> RequestPayload | None:
        """The oldest readings that are missing, out of `span` numbers in a row; None if none is missing."""
        lacking = self._lacking()
        if not lacking:
            return None
        assert self._newest is not None
        first = lacking.bit_length() - 1
        last = max(0, first - min(span, REQUEST_SPAN) + 1)
        oldest_first = format(lacking >> last, "b")
        return RequestPayload((self._newest - first) % SEQUENCES, int(oldest_first[::-1], 2))

    def lacks(self, request: RequestPayload) -> bool:
        """Whether something of a request is missing still."""
        if self._newest is None:
            return False
        lacking, newest = self._lacking(), self._newest
        return any(
            number <= newest and lacking >> (newest - number) & 1 for number in map(self._number, request.sequences())
        )

    def complete(self) -> tuple[SequenceRange, int] | None:
        """The readings in a row, from the oldest that the mote has, that have all arrived, and how many they are."""
        if self._newest is None:
            return None
        count = self._newest - self._oldest + 1 - self._lacking().bit_length()
        return (_range(self._oldest, self._oldest + count - 1), count) if count > 0 else None

    def _lacking(self) -> int:
        if self._newest is None:
            return 0
        return ~self._have & ((1 << (self._newest - self._oldest + 1)) - 1)

    def _number(self, sequence: int) -> int:
        newest = self._newest if self._newest is not None else sequence
        return newest + sequences_after(sequence, newest % SEQUENCES)


def _range(first: int, last: int) -> SequenceRange:
    return SequenceRange(first % SEQUENCES, last % SEQUENCES)
