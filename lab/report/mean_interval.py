"""Means with their intervals, and comparisons of runs of equal seeds."""

import math
from collections.abc import Mapping, Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy import stats

CONFIDENCE = 0.95
FEW = 5
"""Below this number of values an interval is rough: it is too narrow on average."""
RESAMPLES = 4000
"""Of the bootstrap (chosen: its ends vary by some percent of the interval's width)."""


class MeanInterval(msgspec.Struct, frozen=True, kw_only=True):
    """A mean with its 95 % interval, by the percentile bootstrap: both ends are within the range of the values."""

    mean: float
    low: float | None
    """None for a single value, like `high`."""
    high: float | None
    n: int
    """Number of values."""

    @property
    def width(self) -> float:
        """From end to end of the interval; 0 for a single value."""
        return 0.0 if self.low is None or self.high is None else self.high - self.low

    def words(self, decimals: int, scale: float = 1.0, sign: str = "") -> str:
        """The mean and its interval, such as `12.3 [11.0, 14.2]`; without the interval if it has no width.

        Args:
            decimals: of each number.
            scale: factor to the unit that is shown.
            sign: `+` shows the sign of positive numbers as well.

        """
        form = f"{sign},.{decimals}f"
        text = format(scale * self.mean, form)
        if self.low is None or self.high is None or not self.width:
            return text
        return f"{text} [{scale * self.low:{form}}, {scale * self.high:{form}}]"


class PairedDifference(msgspec.Struct, frozen=True, kw_only=True):
    """Differences of pairs of runs with equal seeds."""

    difference: MeanInterval
    """Of the second less the first."""
    share_lower: float
    """Share of the pairs in which the second is lower."""
    share_higher: float
    p: float | None
    """Two-sided paired t-test; None for a single pair. `holm` corrects several."""


def mean_interval(values: Sequence[float]) -> MeanInterval | None:
    """Mean and 95 % interval of at least one value; None if there is none.

    >>> mean_interval([1.0, 2.0, 3.0]).words(1)
    '2.0 [1.0, 3.0]'
    """
    count = len(values)
    if not count:
        return None
    mean = math.fsum(values) / count
    if count == 1:
        return MeanInterval(mean=mean, low=None, high=None, n=1)
    low, high = bootstrap_interval(np.array(values, dtype=np.float64))
    return MeanInterval(mean=mean, low=min(float(low), mean), high=max(float(high), mean), n=count)


def bootstrap_interval(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Ends of the 95 % interval of the mean over the first axis; equal values have equal intervals.

    Percentile bootstrap after Efron and Tibshirani, An Introduction to the Bootstrap, 1993, section 13.3.
    """
    count = len(values)
    drawn = np.random.default_rng(0).multinomial(count, np.full(count, 1.0 / count), RESAMPLES) / count
    ends = np.quantile(drawn @ values, [0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2], axis=0)
    low, high = np.clip(ends, values.min(axis=0), values.max(axis=0))
    return low, high


def paired_difference(first: Mapping[int, float], second: Mapping[int, float]) -> PairedDifference | None:
    """Compare two sets of values by seed; None if they share no seed."""
    differences = [second[seed] - first[seed] for seed in sorted(first.keys() & second.keys())]
    difference = mean_interval(differences)
    if difference is None:
        return None
    return PairedDifference(
        difference=difference,
        share_lower=sum(each < 0 for each in differences) / len(differences),
        share_higher=sum(each > 0 for each in differences) / len(differences),
        p=_p_value(differences, difference.mean),
    )


def holm(p_values: Sequence[float]) -> list[float]:
    """P values corrected for their number, in the same order (Holm, Scandinavian Journal of Statistics 6(2), 1979).

    >>> [round(p, 3) for p in holm([0.01, 0.04, 0.03])]
    [0.03, 0.06, 0.06]
    """
    corrected = [0.0] * len(p_values)
    largest = 0.0
    for rank, index in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[index]))
        corrected[index] = largest
    return corrected


def _p_value(differences: Sequence[float], mean: float) -> float | None:
    count = len(differences)
    if count < 2:
        return None
    error = math.sqrt(math.fsum((each - mean) ** 2 for each in differences) / (count - 1) / count)
    if error == 0.0:
        return 1.0 if mean == 0.0 else 0.0
    return float(2 * stats.t.sf(abs(mean) / error, count - 1))
