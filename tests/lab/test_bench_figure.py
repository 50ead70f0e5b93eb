"""Figures: bounds, whether they are kept, and formatting."""

import math

import msgspec
import pytest

from robrain.lab.bench.figure import Bound, Figure, above, at_least, at_most, below, between, deterministic


@pytest.mark.parametrize(
    ("bound", "kept", "missed"),
    [
        (at_most(50), [49.9, 50.0], [50.1]),
        (at_least(95), [95.0, 96.0], [94.9]),
        (below(100), [99.9], [100.0, 100.1]),
        (above(2), [2.1], [2.0, 1.9]),
        (between(85, 95), [85.0, 90.0, 95.0], [84.9, 95.1]),
    ],
)
def test_bound_is_kept_by_values_on_its_side(bound: Bound, kept: list[float], missed: list[float]) -> None:
    assert all(bound.is_kept_by(value) for value in kept)
    assert not any(bound.is_kept_by(value) for value in missed)


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_missing_value_keeps_no_bound(value: float) -> None:
    figure = deterministic("found again after", value, "s", at_least(-1e9))
    assert figure.value is None
    assert figure.kept is False
    assert figure.value_text() == "none"


def test_kept_follows_from_value_and_bound_whatever_a_file_says() -> None:
    told = b'{"name": "a", "value": 3.0, "bound": {"at_most": 2.0}, "kind": "timing", "kept": true}'
    assert msgspec.json.decode(told, type=Figure).kept is False


@pytest.mark.parametrize("limits", [{}, {"at_most": math.inf}, {"at_least": math.nan}])
def test_bound_without_a_finite_limit_is_refused(limits: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="finite limits"):
        Bound(**limits)
