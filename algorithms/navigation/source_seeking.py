"""Source seeking: where the field of a quantity is greatest, by readings taken around.

A paraboloid of revolution is fitted to the readings near a place, by weighted least squares. Its gradient is the
direction to climb, and near a maximum its vertex is the maximum's place. Readings count the less the farther away and
the older they are. The sums are plain Python, the same on every machine: no library routine takes part.
"""

import math
from collections import deque
from typing import NamedTuple

from robrain.protocol.model.geometry import Point2D

FADE_S = 120.0
"""Readings so old count half of those of now."""
SAMPLES_MAX = 400
"""The robot's oldest readings beyond these are forgotten."""
MOTES_MAX = 200
HIGHEST_OF = 100
BESIDE_M = 0.3
RIDGE = 1e-3
"""Added to the slopes' share of the normal equations: of readings that lie in line, only the slope along counts."""
TERMS = 4
SIGNIFICANT = 3.0
"""Number of standard deviations by which a maximum must be curved."""
FIT_MIN = 6
"""Fewer readings make no fit."""


class FieldSample(NamedTuple):
    """One reading."""

    place: Point2D
    value: float
    time_s: float


class FieldFit(NamedTuple):
    """The field around a place, as fitted."""

    at: Point2D
    """The place."""
    value: float
    """Of the field there."""
    slope: tuple[float, float]
    """Rise per metre along x and y."""
    slope_sd: float
    """Standard deviation of each."""
    summit: Point2D | None
    """Where the fitted field is greatest; None where no maximum is distinguishable from noise."""
    summit_value: float
    summit_sd_m: float
    """Standard deviation of the summit along x or y, by the fit alone; infinite without one."""

    @property
    def steepness(self) -> float:
        """Rise per metre in the steepest direction."""
        return math.hypot(*self.slope)

    @property
    def is_flat(self) -> bool:
        """Whether the slope is indistinguishable from noise."""
        return self.steepness <= 2.0 * self.slope_sd


class FieldSamples:
    """Readings around a robot."""

    def __init__(self) -> None:
        self._samples: deque[FieldSample] = deque(maxlen=SAMPLES_MAX)
        self._of_motes: dict[str, FieldSample] = {}

    def __len__(self) -> int:
        return len(self._samples) + len(self._of_motes)

    def add(self, place: Point2D, value: float, time_s: float) -> None:
        """One more reading of the robot, taken at a place of the arena frame."""
        self._samples.append(FieldSample(place, value, time_s))

    def receive(self, mote: str, place: Point2D, value: float, time_s: float) -> None:
        """A mote's reading: only its latest counts, because fixed motes would otherwise outweigh the moving robot."""
        before = self._of_motes.get(mote)
        if before is None and len(self._of_motes) >= MOTES_MAX:
            return
        if before is None or time_s >= before.time_s:
            self._of_motes[mote] = FieldSample(place, value, time_s)

    def highest(self) -> FieldSample | None:
        """The greatest of the robot's last readings, each averaged with those right beside it; None before any."""
        last = list(self._samples)[-HIGHEST_OF:]
        best = None
        for sample in last:
            beside = [
                other.value
                for other in last
                if math.hypot(other.place.x_m - sample.place.x_m, other.place.y_m - sample.place.y_m) <= BESIDE_M
            ]
            mean = sum(beside) / len(beside)
            if best is None or mean > best.value:
                best = FieldSample(sample.place, mean, sample.time_s)
        return best

    def fit(self, at: Point2D, now_s: float, width_m: float) -> FieldFit | None:
        """The field around a place, to which readings `width_m` away count a quarter; None if too little is known."""
        samples = [*self._samples, *self._of_motes.values()]
        if len(samples) < FIT_MIN:
            return None
        normal = [[0.0] * TERMS for _ in range(TERMS)]
        right = [0.0] * TERMS
        base = sum(sample.value for sample in samples) / len(samples)
        rows = []
        for sample in samples:
            x, y = (sample.place.x_m - at.x_m) / width_m, (sample.place.y_m - at.y_m) / width_m
            square = x * x + y * y
            age_s = max(0.0, now_s - sample.time_s)
            weight = 1.0 / ((1.0 + square) * (1.0 + square) * (1.0 + age_s / FADE_S))
            terms = (1.0, x, y, square)
            rows.append((terms, weight, sample.value - base))
            for i in range(TERMS):
                right[i] += weight * terms[i] * (sample.value - base)
                for j in range(TERMS):
                    normal[i][j] += weight * terms[i] * terms[j]
        for i in range(1, TERMS):
            normal[i][i] += RIDGE * normal[0][0]
        inverse = _inverse(normal)
        found = [sum(inverse[i][j] * right[j] for j in range(TERMS)) for i in range(TERMS)]
        whole = square_sum = 0.0
        for terms, weight, value in rows:
            residual = value - sum(found[i] * terms[i] for i in range(TERMS))
            square_sum += weight * residual * residual
            whole += weight
        variance = square_sum / whole * len(rows) / max(1, len(rows) - TERMS)
        slope_sd = math.sqrt(variance * max(inverse[1][1], inverse[2][2], 0.0)) / width_m
        curve, curve_sd = found[3], math.sqrt(variance * max(inverse[3][3], 0.0))
        slope = (found[1] / width_m, found[2] / width_m)
        summit, summit_value, summit_sd_m = None, math.nan, math.inf
        if curve < -SIGNIFICANT * curve_sd:
            along_x, along_y = -found[1] / (2.0 * curve), -found[2] / (2.0 * curve)
            summit = Point2D(at.x_m + width_m * along_x, at.y_m + width_m * along_y)
            summit_value = base + found[0] - curve * (along_x * along_x + along_y * along_y)
            summit_sd_m = slope_sd * width_m * width_m / (2.0 * -curve)
        return FieldFit(at, base + found[0], slope, slope_sd, summit, summit_value, summit_sd_m)


def _inverse(matrix: list[list[float]]) -> list[list[float]]:
    """Of a symmetric, positive definite matrix, by Gauss and Jordan without exchanges of rows."""
    size = len(matrix)
    rows = [[*row, *(1.0 if i == j else 0.0 for j in range(size))] for i, row in enumerate(matrix)]
    for i in range(size):
        pivot = rows[i][i]
        rows[i] = [value / pivot for value in rows[i]]
        for k in range(size):
            if k != i and rows[k][i] != 0.0:
                factor = rows[k][i]
                rows[k] = [value - factor * own for value, own in zip(rows[k], rows[i], strict=True)]
    return [row[size:] for row in rows]
