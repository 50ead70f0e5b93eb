"""Allocation without a coordinator, beside `optimal`: problems that its parameters were not chosen on."""

from collections.abc import Iterator

from robrain.lab.bench.allocation import consensus
from robrain.lab.bench.figure import Figure

SEEDS = range(41, 45)
"""The parameters of the rounds were chosen on 1 to 40."""


def measure() -> Iterator[Figure]:
    """Gaps, exchanges and bytes of 5 robots and 50 tasks."""
    return consensus.measure(consensus.SIZES[:1], SEEDS)
