import json

from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.safe_text import safe_json, safe_lines, safe_text

ANY = st.text(st.characters(codec=None), max_size=40)


@given(ANY)
def test_safe_text_is_one_line_of_characters_that_are_seen(text: str) -> None:
    shown = safe_text(text)
    assert all(char.isprintable() or char in "\xad" or ord(char) > 0x9F for char in shown)
    assert "\x1b" not in shown
    assert len(shown.splitlines()) <= 1


@given(ANY)
def test_no_line_of_a_foreign_text_passes_for_one_of_the_programs_own(text: str) -> None:
    first, *others = safe_lines(text, "  ").split("\n")
    assert all(line.startswith("  ") and safe_text(line) == line for line in others)
    assert safe_text(first) == first


@given(st.text(st.characters(min_codepoint=32, max_codepoint=126)))
def test_ordinary_text_stays_as_it_is(text: str) -> None:
    assert safe_text(text) == text


@given(ANY, st.integers(1, 20))
def test_a_limit_is_kept(text: str, limit: int) -> None:
    assert len(safe_text(text, limit)) <= limit


@given(st.text(max_size=40))
def test_safe_json_means_what_it_meant(text: str) -> None:
    encoded = json.dumps(text, ensure_ascii=False)
    shown = safe_json(encoded.encode())
    assert json.loads(shown) == text
    assert "\x9b" not in shown
    assert "\u202e" not in shown
