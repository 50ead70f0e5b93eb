"""Silence is the source's, not the pause of the process that listens."""

from hypothesis import given
from hypothesis import strategies as st

from robrain.agent.silence import Silence

LIMIT_NS = 400


def test_silence_is_what_has_passed_since_the_source_was_heard() -> None:
    silence = Silence(LIMIT_NS)
    silence.heard(1000)
    assert [silence.look(1000 + passed) for passed in (0, 50, 100, 200, 390, 410)] == [0, 50, 100, 200, 390, 410]
    silence.heard(1500)
    assert silence.look(1500) == 0


def test_pause_of_the_process_counts_for_half_of_the_limit() -> None:
    silence = Silence(LIMIT_NS)
    silence.heard(0)
    assert silence.look(100) == 100
    assert silence.look(100_000) == 300
    silence.heard(100_010)  # what was waiting is read
    assert silence.look(100_110) == 100


def test_clock_that_is_set_back_is_no_silence() -> None:
    silence = Silence(LIMIT_NS)
    silence.heard(5000)
    assert silence.look(1000) == 0
    assert silence.look(1100) == 100


@given(st.lists(st.integers(1, LIMIT_NS // 2), max_size=50))
def test_silence_is_exact_while_the_plugin_is_awake(gaps: list[int]) -> None:
    silence, now = Silence(LIMIT_NS), 7
    silence.heard(now)
    for gap in gaps:
        now += gap
        assert silence.look(now) == now - 7


@given(st.lists(st.integers(LIMIT_NS // 2, 10_000), min_size=3, max_size=10))
def test_silent_source_is_noticed_by_the_third_look_however_far_apart_they_are(gaps: list[int]) -> None:
    silence, now, found = Silence(LIMIT_NS), 0, []
    silence.heard(0)
    for gap in gaps:
        now += gap
        found.append(silence.look(now))
    assert found[1] <= LIMIT_NS
    assert found[2] > LIMIT_NS
