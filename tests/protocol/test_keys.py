import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.errors import BadName
from robrain.protocol.keys import check_name

NAME_LETTERS = "abcXYZ019_.-"


@pytest.mark.parametrize("name", ["r1", "_", "R2-D2", "0", "a.b_c-d", "x" * 63])
def test_ordinary_names_are_taken_as_they_are(name):
    assert check_name("robot", name) == name


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("", "it is empty"),  # would make two slashes stand together
        ("r*", r"\* may not stand in a name"),  # Zenoh: any within a chunk
        ("**", r"\* may not stand in a name"),  # Zenoh: any number of chunks
        ("a/b", "/ may not stand in a name"),  # would make two chunks of one
        ("r#1", "# may not stand in a name"),  # reserved in key expressions
        ("r$*", r"\$ \* may not stand in a name"),  # Zenoh: any within a chunk, the long form
        ("r$1", r"\$ may not stand in a name"),  # reserved in key expressions
        ("r?1", r"\? may not stand in a name"),  # begins the parameters of a selector
        ("@r1", "@ may not stand in a name"),  # Zenoh's own chunks, which `**` does not match
        ("r 1", "letters, digits"),  # a space
        ("r1\n", "letters, digits"),  # a line break at the end, which `$` in a regular expression lets pass
        ("größe", "letters, digits"),  # a letter, but none of ASCII
        ("１", "letters, digits"),  # a digit, but none of ASCII
        ("-r1", "must start with"),  # reads like an option on a command line
        (".", "must start with"),  # a folder, where names become file names
        ("..", "must start with"),  # the folder above
        ("x" * 64, "longer than 63"),  # one too many
    ],
)
def test_a_name_that_no_key_can_hold_is_refused_in_words(name, why):
    with pytest.raises(BadName, match=why) as refused:
        check_name("robot", name)
    assert refused.value.name == name
    assert str(refused.value).startswith(f"bad robot name {name!r}: ")


@given(st.one_of(st.text(max_size=70), st.text(alphabet=NAME_LETTERS + "*/#$?@ ", max_size=5)))
def test_whatever_is_taken_is_one_plain_chunk(name):
    try:
        check_name("team", name)
    except BadName:
        return
    assert 1 <= len(name) <= 63
    assert name.isascii()
    assert not set(name) & set("*/#$?@ ")
