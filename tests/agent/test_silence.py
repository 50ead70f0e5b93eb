"""Silence is the source's, not the pause of the process that listens."""

from hypothesis import given
from hypothesis import strategies as st

from robrain.agent.silence import Silence

LIMIT_NS = 400


def test_pause_of_the_process_counts_for_half_of_the_limit() -> None:
    silence = Silence(LIMIT_NS)
    assert silence.since(0, 100) == 100
    assert silence.since(0, 100_000) == 300
    assert silence.since(100_010, 100_110) == 100  # what was waiting is read


def test_clock_that_is_set_back_is_no_silence() -> None:
    silence = Silence(LIMIT_NS)
    assert silence.since(5000, 1000) == 0
    assert silence.since(5000, 1100) == 100


@given(st.lists(st.integers(1, LIMIT_NS // 2), max_size=50))
def test_silence_is_exact_while_the_plugin_is_awake(gaps: list[int]) -> None:
    silence, now = Silence(LIMIT_NS), 7
    for gap in gaps:
        now += gap
        assert silence.since(7, now) == now - 7


@given(st.lists(st.integers(LIMIT_NS // 2, 10_000), min_size=3, max_size=10))
def test_silent_source_is_noticed_by_the_third_question_however_far_apart_they_are(gaps: list[int]) -> None:
    silence, now, found = Silence(LIMIT_NS), 0, []
    for gap in gaps:
        now += gap
        found.append(silence.since(0, now))
    assert found[1] <= LIMIT_NS
    assert found[2] > LIMIT_NS
