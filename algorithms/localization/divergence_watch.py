"""Whether an estimator still deserves to be believed: its innovations must be as large as it says, not larger."""

from collections import deque

import msgspec


class WatchSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """When innovations are too large. Raises ValueError where it is built with a window below 2.

    The mean normalised innovation squared (NIS) of `window` measurements is that of a chi-square variable divided by
    the window (Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to Tracking and Navigation*, section 5.4.2):
    for a window of 32 it exceeds 2.6 once in a million times if all is well.
    """

    window: int = 32
    nis_max: float = 2.6
    refused_max: float = 0.3
    """Share of the window that the gate may refuse."""
    misfits_max: int = 8
    """So many scans in a row may lie badly on the map."""
    fit_min: float = 0.65
    """Share of a scan's beams that have to end at the map's walls."""

    def __post_init__(self) -> None:
        if self.window < 2:
            raise ValueError(f"expected window >= 2, got {self.window}")


class DivergenceWatch:
    """Counts, and says why the estimate cannot be right.

    Args:
        spec: when that is.
        gate: innovations squared count up to this; what lies beyond counts as refused.

    """

    def __init__(self, spec: WatchSpec, gate: float) -> None:
        self.spec = spec
        self.refused = 0
        """Measurements that the gate has refused, since the beginning."""
        self._gate = gate
        self._nis: deque[float] = deque(maxlen=spec.window)
        self.misfits = 0
        """Number of scans in a row that lie badly on the map."""

    @property
    def mean_nis(self) -> float:
        """Of the window, with refused ones at the gate; 0 before the first measurement."""
        return sum(self._nis) / len(self._nis) if self._nis else 0.0

    def heard(self, nis: float) -> str:
        """A measurement had this NIS; why the estimate cannot be right, or nothing."""
        self.refused += nis > self._gate
        self._nis.append(min(nis, self._gate))
        if len(self._nis) < self.spec.window:
            return ""
        gate = self._gate
        refused = len([each for each in self._nis if each >= gate])
        if refused > self.spec.refused_max * self.spec.window:
            return f"{refused} of the last {self.spec.window} signals of motes contradict the estimated pose"
        if self.mean_nis > self.spec.nis_max:
            return (
                f"signals of motes are off by {self.mean_nis:.1f} times the variance expected, "
                f"over the last {self.spec.window}"
            )
        return ""

    def saw(self, fit: float) -> str:
        """A scan lay so well on the map; why the estimate cannot be right, or nothing."""
        self.misfits = self.misfits + 1 if fit < self.spec.fit_min else 0
        if self.misfits >= self.spec.misfits_max:
            return f"{self.misfits} scans in a row do not fit the map, the last one by {fit:.0%} of its beams"
        return ""

    def begin_anew(self) -> None:
        """Forget what was counted, but for the refused ones."""
        self._nis.clear()
        self.misfits = 0
