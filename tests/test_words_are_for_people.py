"""No decision searches or compares the sentence of a reason: what decides looks at the reason itself."""

import ast
from collections.abc import Iterator

import pytest

from tests.product import FOLDERS, ROOT

SHOWS = ("dashboard", "recording")
"""Only show what others decided."""

SENTENCES = {"why", "refusal"}
"""Fields that hold the words of a reason."""
SPEAK = {"sentence_of", "words"}
"""Functions that make them."""
SEARCHES = {
    "startswith", "endswith", "find", "rfind", "index", "rindex", "count", "split", "rsplit", "splitlines", "partition",
    "rpartition", "removeprefix", "removesuffix", "replace", "isdigit",
}  # fmt: skip
PATTERNS = {"search", "match", "fullmatch", "sub", "subn", "split", "findall", "finditer"}


def is_sentence(node: ast.AST) -> bool:
    match node:
        case ast.Attribute(attr=name) if name in SENTENCES:
            return True
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)) if name in SPEAK:
            return True
    return False


def searched(tree: ast.AST) -> Iterator[int]:
    """Lines in which a sentence is compared or searched; whether there is one may be asked."""
    for node in ast.walk(tree):
        match node:
            case ast.Compare(ops=[ast.Is() | ast.IsNot()]):
                pass
            case ast.Compare(left=left, comparators=right) if any(map(is_sentence, (left, *right))):
                yield node.lineno
            case ast.Call(func=ast.Attribute(value=value, attr=name)) if name in SEARCHES and is_sentence(value):
                yield node.lineno
            case ast.Call(func=ast.Attribute(attr=name), args=given) if name in PATTERNS and any(
                map(is_sentence, given)
            ):
                yield node.lineno
            case ast.Match(subject=subject, cases=cases) if is_sentence(subject):
                yield from (case.pattern.lineno for case in cases if isinstance(case.pattern, ast.MatchValue))


@pytest.mark.parametrize(
    ("line", "is_found"),
    [
        ("if 'reserve' in left.why: pass", True),
        ("if record.why == other.why: pass", True),
        ("if sentence_of(reason) != record.text: pass", True),
        ("record.why.startswith('waits')", True),
        ("FOR_ENERGY.search(left.why)", True),
        ("NUMBER.sub('', sentence_of(reason))", True),
        ("match bid.refusal:\n    case 'x': pass", True),
        ("if record.why: say(record.why)", False),
        ("if reply.refusal is not None: pass", False),
        ("match left.why:\n    case NotSeen(): pass", False),
        ("isinstance(record.reason, Gone)", False),
        ("if shunning.why(task, robot, 0) is None: pass", False),
        ("record.reason == other.reason", False),
    ],
)
def test_what_searches_words_is_found(line: str, is_found: bool) -> None:
    assert bool(list(searched(ast.parse(line)))) is is_found


@pytest.mark.slow
def test_no_decision_searches_words() -> None:
    found = [
        f"{name}:{line}"
        for folder in FOLDERS
        for path in sorted((ROOT / folder).rglob("*.py"))
        if not (name := str(path.relative_to(ROOT))).startswith(SHOWS)
        for line in searched(ast.parse(path.read_text(encoding="utf-8")))
    ]
    assert found == []
