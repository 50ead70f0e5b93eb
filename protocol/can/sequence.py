"""Gaps in the counters of received frames: what was lost on the way."""

MODULUS = 256
LONGEST_GAP = 64
"""A step beyond this, or backwards, is a sender that has restarted rather than a loss."""


class SequenceWatch:
    """Follows the 8-bit counter of one kind of frame.

    Attributes:
        lost: frames that never came, by the gaps between those that did.
        repeated: frames with the counter of the one before: sent twice, or by two senders.
        expected: the next counter if nothing is lost; None before the first. Who reads many frames may take that one
            without `note`, and count it up.

    """

    def __init__(self) -> None:
        self.lost = 0
        self.repeated = 0
        self.expected: int | None = None

    def note(self, counter: int) -> int:
        """Take the counter of a frame that is believed; how many frames are missing before it."""
        expected, self.expected = self.expected, (counter + 1) % MODULUS
        if expected is None:
            return 0
        step = (counter + 1 - expected) % MODULUS
        if step == 0:
            self.repeated += 1
            return 0
        missing = step - 1 if step <= LONGEST_GAP else 0
        self.lost += missing
        return missing
