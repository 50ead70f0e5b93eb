"""Figures: bounds, whether they are kept, and formatting."""

import math

import msgspec
import pytest

from robrain.lab.bench.figure import (
    Bound,
    Figure,
    FigureKind,
    above,
    are_kept,
    at_least,
    at_most,
    below,
    between,
    deterministic,
    timing,
    with_unit,
)


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


def test_figure_without_a_bound_is_neither_kept_nor_missed() -> None:
    assert timing("way", 3.0, "m").kept is None
    assert are_kept([timing("way", 3.0, "m")])


def test_one_missed_bound_is_told_of_the_whole() -> None:
    assert not are_kept([timing("a", 1, "", at_most(1)), timing("b", 2, "", at_most(1))])


def test_kept_follows_from_value_and_bound_whatever_a_file_says() -> None:
    told = b'{"name": "a", "value": 3.0, "bound": {"at_most": 2.0}, "kind": "timing", "kept": true}'
    assert msgspec.json.decode(told, type=Figure).kept is False


def test_figure_is_the_same_after_json() -> None:
    figure = timing("age, p99", 111.25, "ms", between(1, 200), "median 58 ms")
    assert msgspec.json.decode(msgspec.json.encode(figure), type=Figure) == figure
    assert figure.kind is FigureKind.TIMING


@pytest.mark.parametrize("limits", [{}, {"at_most": math.inf}, {"at_least": math.nan}])
def test_bound_without_a_finite_limit_is_refused(limits: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="finite limits"):
        Bound(**limits)


@pytest.mark.parametrize(
    ("bound", "words"),
    [
        (at_most(50), "≤ 50 ms"),
        (between(85, 95), "≥ 85 ms and ≤ 95 ms"),
        (below(100), "< 100 ms"),
        (above(2), "> 2 ms"),
    ],
)
def test_bound_is_shown_with_its_direction(bound: Bound, words: str) -> None:
    assert bound.words("ms") == words


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (0, "0"),
        (0.00001234, "0"),
        (0.00012, "0.0001"),
        (1.166, "1.17"),
        (99.949, "99.9"),
        (1234567, "1,234,567"),
        (-3.25, "-3.25"),
    ],
)
def test_numbers_are_shown_with_three_significant_digits(value: float, words: str) -> None:
    assert with_unit(value, "") == words
    assert with_unit(value, "m") == f"{words} m"
