from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.agent.errors import ManifestError, short_path
from robrain.agent.manifest import read_manifest
from robrain.agent.transform import Transform, TransformTable

# Section 4.1 of the paper: BEGIN>1, END<0, ROSES=2.
MANIFEST = """
[plugin]
class = "garden:Garden"

[transform]
incoming = { BEGIN = "1" }
outgoing = { 0 = "END" }
both = { ROSES = "2" }
"""


def paper(tmp_path: Path) -> Transform:
    path = tmp_path / "garden.toml"
    path.write_text(MANIFEST, encoding="utf-8")
    return Transform(read_manifest(path).transform)


@pytest.mark.parametrize(
    ("said", "got"),
    [
        ("BEGIN", "1"),  # BEGIN>1
        ("ROSES", "2"),  # ROSES=2
        ("count=ROSES", "count=2"),  # the value of a named argument
        ("[BEGIN, ROSES]", "[1, 2]"),  # each whole word
        ("BEGINNING", "BEGINNING"),  # but no part of one
        ('"BEGIN"', '"BEGIN"'),  # nor within quotes
        ("o'BEGIN", "o'1"),  # an apostrophe does not begin quotes
    ],
)
def test_incoming_words_become_the_plugins(tmp_path, said, got):
    assert paper(tmp_path).incoming([said, "7"]) == [got, "7"]


@pytest.mark.parametrize(
    ("said", "got"),
    [
        ("0", "END"),  # END<0
        ("2", "ROSES"),  # ROSES=2, the other way round
        ("[0, 2, 20]", "[END, ROSES, 20]"),
        ('{"0": 0}', '{"0": END}'),
    ],
)
def test_outgoing_words_become_the_callers(tmp_path, said, got):
    assert paper(tmp_path).outgoing(said) == got


@pytest.mark.parametrize(
    ("table", "key", "complaint"),
    [
        ('incoming = { "TWO WORDS" = "1" }', "transform", "expected one word"),
        ('incoming = { A = "1" }\nboth = { A = "2" }', "transform", "two for A"),  # one word, two meanings
        ('both = { A = "2", B = "2" }', "transform", "two for 2"),  # which of them comes out?
        ('inwards = { A = "1" }', "transform", "unknown key `inwards`"),
    ],
)
def test_a_table_that_cannot_be_is_refused_with_its_file_and_key(tmp_path, table, key, complaint):
    path = tmp_path / "garden.toml"
    path.write_text(f'[plugin]\nclass = "garden:Garden"\n[transform]\n{table}', encoding="utf-8")
    with pytest.raises(ManifestError) as refusal:
        read_manifest(path)
    assert refusal.value.key.startswith(key)
    assert complaint in str(refusal.value)
    assert short_path(path) in str(refusal.value)


word = st.from_regex(r"[A-Za-z0-9_.\-]{1,8}", fullmatch=True)


@pytest.mark.slow
@given(st.dictionaries(word, word, max_size=5), st.lists(word, max_size=8))
def test_words_of_both_directions_come_back_as_they_went_in(both, words):
    try:
        transform = Transform(TransformTable(both=both))
    except ValueError:
        return  # two words for one
    said = [word for word in words if word in both or word not in both.values()]
    assert [transform.outgoing(word) for word in transform.incoming(said)] == said


@pytest.mark.slow
@given(st.text())
def test_any_text_is_translated_without_an_error(text):
    transform = Transform(msgspec.convert({"both": {"A": "1"}}, TransformTable))
    assert isinstance(transform.outgoing(text), str)
    assert len(transform.incoming([text])) == 1
