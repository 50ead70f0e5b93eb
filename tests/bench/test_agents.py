"""The growth of a process' memory, from looks at it once a second."""

import math
from collections.abc import Callable

import pytest

from tests.bench.agents import GROWTH_BOUND_MB, WARM_UP_S, ProcessSample, growth_in_ten_minutes_mb


def looks(minutes: float, resident_mb: Callable[[float], float]) -> list[ProcessSample]:
    return [ProcessSample(1000.0 + at_s, 0.0, resident_mb(at_s)) for at_s in range(round(60 * minutes) + 1)]


def wavy_mb(at_s: float) -> float:
    """Up and down as an allocator lets it."""
    return 300.0 + 1.5 * math.sin(at_s / 7.0) + math.sin(at_s / 31.0)


@pytest.mark.parametrize("leak_mb", [0.0, 2.0, 4.0, 20.0])
def test_leak_is_told_as_what_it_is_whatever_the_allocator_does_within_a_minute(leak_mb: float) -> None:
    found_mb = growth_in_ten_minutes_mb(looks(10.0, lambda at_s: wavy_mb(at_s) + leak_mb * at_s / 600.0))
    assert found_mb == pytest.approx(leak_mb, abs=GROWTH_BOUND_MB / 2)


def test_leak_of_a_block_now_and_then_is_told() -> None:
    found_mb = growth_in_ten_minutes_mb(looks(10.0, lambda at_s: 300.0 + 3.0 * (at_s // 90.0)))
    assert found_mb is not None
    assert found_mb > 5 * GROWTH_BOUND_MB


def test_what_is_taken_once_at_the_beginning_is_no_growth() -> None:
    found_mb = growth_in_ten_minutes_mb(looks(10.0, lambda at_s: 295.0 if at_s < 0.9 * WARM_UP_S else 301.0))
    assert found_mb == pytest.approx(0.0, abs=1e-9)


def test_few_minutes_tell_no_growth() -> None:
    assert growth_in_ten_minutes_mb(looks(4.0, wavy_mb)) is None
    assert growth_in_ten_minutes_mb(looks(4.3, wavy_mb)) is not None
