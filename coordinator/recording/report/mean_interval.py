"""Means with their intervals, and comparisons of runs of equal seeds."""

import math
from collections.abc import Mapping, Sequence

import msgspec
from scipy import stats

CONFIDENCE = 0.95


class MeanInterval(msgspec.Struct, frozen=True, kw_only=True):
    """A mean with its 95 % interval, by Student's t."""

    mean: float
    low: float | None
    """None for a single value, like `high`."""
    high: float | None
    n: int
    """Number of values."""

    @property
    def half_width(self) -> float | None:
        """What follows the ± sign; None for a single value."""
        return None if self.high is None else self.high - self.mean


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

    >>> found = mean_interval([1.0, 2.0, 3.0])
    >>> f"{found.mean:.1f} ± {found.half_width:.3f}"
    '2.0 ± 2.484'
    """
    count = len(values)
    if not count:
        return None
    mean = math.fsum(values) / count
    if count == 1:
        return MeanInterval(mean=mean, low=None, high=None, n=1)
    half = t_factor(count) * math.sqrt(math.fsum((value - mean) ** 2 for value in values) / (count - 1) / count)
    return MeanInterval(mean=mean, low=mean - half, high=mean + half, n=count)


def t_factor(count: int) -> float:
    """Standard errors of the mean of `count` values (two or more) from it to the end of its 95 % interval."""
    return float(stats.t.ppf(0.5 + CONFIDENCE / 2, count - 1))


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
