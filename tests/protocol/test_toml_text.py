import codecs
import os
import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.errors import BadToml
from robrain.protocol.toml_text import LARGE, parse_toml, read_toml

HOSTILE = {
    "a dotted key of 20,000 parts": ".".join(["a"] * 20_000) + "=1",
    "a quoted dotted key": ".".join(['"a"'] * 9_000) + "=1",
    "dots with blanks between": " . ".join(["a"] * 9_000) + "=1",
    "a header of 20,000 parts": "[" + ".".join(["a"] * 20_000) + "]",
    "arrays in arrays": "a=" + "[" * 9_000 + "]" * 9_000,
    "inline tables in inline tables": "a=" + "{b=" * 9_000 + "1" + "}" * 9_000,
    "inline tables and dots": "a=" + "{b.c=" * 10 + "1" + "}" * 10,
    "arrays behind a string that ends in quotes": 'a=[""""x"""",' + "[" * 9_000 + "]" * 9_001,
    "arrays behind a literal string that ends in quotes": "a=[''''x''''," + "[" * 9_000 + "]" * 9_001,
    "arrays behind an escaped quote": 'a=["\\"",' + "[" * 9_000 + "]" * 9_001,
    "arrays behind a comment with a quote": 'a=1 # "\nb=' + "[" * 9_000 + "]" * 9_000,
}


@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
def test_what_is_nested_too_deep_is_refused_with_the_line_before_it_is_parsed(monkeypatch, text):
    monkeypatch.setattr(tomllib, "loads", lambda _: pytest.fail("it was parsed"))
    with pytest.raises(BadToml, match=r"expected at most 16 levels of nesting \(line [12]\)"):
        parse_toml(text)


@pytest.mark.parametrize(
    "text",
    [
        "\n".join(f"a{n}=1" for n in range(5_000)),
        "a={" + ",".join(f"b{n}=1" for n in range(5_000)) + "}",
        "[a]\n" * 5_000,
    ],
    ids=["keys", "keys of an inline table", "headers"],
)
def test_too_many_keys_are_refused_before_they_are_parsed(monkeypatch, text):
    monkeypatch.setattr(tomllib, "loads", lambda _: pytest.fail("it was parsed"))
    with pytest.raises(BadToml, match="expected at most 4096 keys"):
        parse_toml(text)


def test_no_more_of_a_file_is_read_than_may_be_parsed(tmp_path):
    path = tmp_path / "large.toml"
    with path.open("wb") as file:
        file.truncate(1 << 40)  # a sparse terabyte, which takes too long to read
    with pytest.raises(BadToml, match="expected at most 64 kB"):
        read_toml(path)


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.toml")
    with pytest.raises(BadToml, match="it is not a regular file"):
        read_toml(tmp_path / "pipe.toml")


@pytest.mark.parametrize(
    ("data", "why"),
    [(b"\xff", "cannot be read: .*utf-8"), (b"a =", "is not TOML"), (b"a = " + b"9" * 5000, "is not TOML: Exceeds")],
    ids=["not UTF-8", "not TOML", "a number too long"],
)
def test_what_is_wrong_with_a_file_is_said(tmp_path, data, why):
    path = tmp_path / "bad.toml"
    path.write_bytes(data)
    with pytest.raises(BadToml, match=why):
        read_toml(path)


USUAL = """
# a comment with [ brackets { and "quotes
[parameters]
angles = [0.0, 1.5, -2.25, 1e3, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 16.0, 17.0]
version = "1.2.3.4.5.6.7.8.9.10.11.12.13.14.15.16.17"
text = '''
a.b.c.d.e.f.g.h.i.j.k.l.m.n.o.p.q.r.s.t.u.v.w.x.y.z [[[[[[[[[[[[[[[[[[[[[[
'''
more = \"\"\"\\\"\"\" [[[[[[[[[[[[[[[[[[[[\"\"\"
[tag.x."a.b"]
when = 2005-06-01T12:00:00.5Z
"""


@pytest.mark.parametrize("begin", [b"", codecs.BOM_UTF8])
def test_a_usual_file_is_read_as_tomllib_reads_it(tmp_path, begin):
    path = tmp_path / "usual.toml"
    path.write_bytes(begin + USUAL.replace("\n", "\r\n").encode())
    assert read_toml(path) == tomllib.loads(USUAL)


@given(st.text(alphabet="ab\"'\\\n[]{}=.,# 1", max_size=200))
def test_any_text_is_read_as_tomllib_reads_it_or_refused(text):
    try:
        wanted = tomllib.loads(text)
    except (ValueError, RecursionError):
        wanted = None
    found, why = None, ""
    try:
        found = parse_toml(text)
    except BadToml as error:
        why = str(error)
    assert found == wanted or "levels of nesting" in why


def depth_of(value: object) -> int:
    if isinstance(value, dict):
        return 1 + max(map(depth_of, value.values()), default=0)
    if isinstance(value, list):
        return 1 + max(map(depth_of, value), default=0)
    return 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "unit", ['\\"""\n', "'''", '"""', '"', "'", '"\\', "[a]\n", "a.", "[", "#", '\\"""x\\'], ids=repr
)
def test_the_look_beforehand_ends_for_any_text_that_is_not_too_large(monkeypatch, unit):
    """A check of quadratic cost would not finish a megabyte within a test."""
    looked: list[str] = []
    monkeypatch.setattr(tomllib, "loads", lambda text: looked.append(text) or {})
    limits = LARGE._replace(depth=1 << 30, keys=1 << 30)
    text = unit * (limits.kilobytes * 1024 // len(unit))
    parse_toml(text, limits)
    assert looked == [text]
