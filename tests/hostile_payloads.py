"""Payloads that no component of robrain sends, for every topic and query: drawn by hypothesis, or a fixed choice."""

import json
from collections.abc import Iterator
from pathlib import Path
from types import NoneType
from typing import Any, get_args

from hypothesis import strategies as st

from robrain.protocol.topic import Query, Topic

GOLDEN = Path(__file__).parent / "protocol" / "golden"
EXTREMES = (None, True, -1, 0, 2**53, 2**63, 10**40, 1e308, -1e308, "", "x" * 5000, "\u202e", [], {}, [[]], {"a": {}})
"""Values that are put in place of others."""
BROKEN = (b"", b"{", b"\xff\xfe", b"null", b"7", b'"text"', b"[]", b"{}", b"[" * 5000, b'{"a":' * 5000, b"\x00" * 64)
"""Payloads that are no message of any type; some count as an empty request."""


def sample_of(kind: Any) -> Any:
    """A message of a type as JSON data; None if its type says nothing."""
    for one in (kind, *get_args(kind)):
        for path in GOLDEN.rglob(f"{getattr(one, '__name__', '')}.json"):
            return json.loads(path.read_bytes())
    return None


def places(value: Any, where: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Each place in JSON data."""
    yield where
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in inner:
        yield from places(part, (*where, key))


def with_value(whole: Any, where: tuple[str | int, ...], value: Any) -> Any:
    """The data with another value in one place."""
    if not where:
        return value
    copy = dict(whole) if isinstance(whole, dict) else list(whole)
    copy[where[0]] = with_value(whole[where[0]], where[1:], value)
    return copy


def kind_of(row: Topic[Any] | Query[Any, Any]) -> Any:
    """The type of what is sent under a key: a message, or a request."""
    return row.message if isinstance(row, Topic) else row.request


def payloads(row: Topic[Any] | Query[Any, Any]) -> st.SearchStrategy[bytes]:
    """Anything: broken bytes, any JSON, and samples of the type with a value changed; some happen to be valid."""
    options = [st.sampled_from(BROKEN), st.binary(max_size=200), JSON.map(encode)]
    sample = None if kind_of(row) in (None, bytes, NoneType) else sample_of(kind_of(row))
    if sample is not None:
        where, value = st.sampled_from(list(places(sample))), st.sampled_from(EXTREMES)
        changed = st.builds(with_value, st.just(sample), where, value)
        cut = st.integers(0, len(encode(sample))).map(lambda length: encode(sample)[:length])
        options += [changed.map(encode), changed.map(encode), cut]
    return st.one_of(options)


def fixed_payloads(row: Topic[Any] | Query[Any, Any]) -> list[bytes]:
    """The broken ones, one too large, and a sample with each extreme in turn in one of its places."""
    codec = row.payloads if isinstance(row, Topic) else row.requests
    found = [*BROKEN, b" " * (codec.max_bytes + 1)]
    sample = None if kind_of(row) in (None, bytes, NoneType) else sample_of(kind_of(row))
    if sample is not None:
        where = list(places(sample))
        found += [
            encode(with_value(sample, where[number % len(where)], value)) for number, value in enumerate(EXTREMES)
        ]
    return found


def encode(value: Any) -> bytes:
    """As JSON; lone halves of characters are written as escapes."""
    return json.dumps(value).encode()


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)
