"""Counts names and sentences that are not plain technical English, for the ceilings of `make check`.

The rules: standard verbs and nouns in names, at most `WORDS_MAX` words in a sentence, no relative pronoun at its
beginning, no colloquial phrase. `python -m tests.words` lists what it counts.
"""

import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

from tests.product import FOLDERS, ROOT

WORDS_MAX = 25
VERBS = {
    *(
        "anew",
        "hear",
        "heard",
        "hears",
        "hearing",
        "knew",
        "knows",
        "look",
        "looked",
        "looking",
        "looks",
        "mate",
        "mates",
    ),
    *(
        "note",
        "noted",
        "notes",
        "said",
        "say",
        "says",
        "stand",
        "stands",
        "stood",
        "standing",
        "take",
        "taken",
        "takes",
    ),
    *("taking", "tell", "telling", "tells", "told", "took", "way", "ways", "why", "whoever"),
}
CLASS_WORDS = VERBS | {"desk", "watch", "view"}
STANDARD = re.compile(r"right_of_way|stand_?by|take_over|look_(?:ahead|at|up)|^_*why$|^tell$", re.IGNORECASE)
"""Standard terms that contain such words: `robrain task why`, and `tell` of Python's binary files."""
TABLE = re.compile(r"^\s*[|│├└].*$", re.MULTILINE)
BEGINNING = re.compile(r"(?:What|Who|Whoever|As long|So many)\b(?!.*\?$)")
PHRASE = re.compile(
    r"\b(?:anew|whoever|so many|of (?:its|their) own|as long as|lets? go of|heard of|is told|are told|tells? of)\b",
    re.IGNORECASE,
)
SENTENCE_END = re.compile(r"(?<=[.!?])\s+(?=[A-Z`*])")
PAGES = ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "docs")


def dialect_names() -> Iterator[tuple[Path, str]]:
    """Yield each definition of the product whose name has such a word."""
    for path in _sources():
        for node in ast.walk(ast.parse(path.read_text())):
            match node:
                case ast.ClassDef(name=name):
                    words = CLASS_WORDS
                case ast.FunctionDef(name=name) | ast.arg(arg=name):
                    words = VERBS
                case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                    words = VERBS
                case _:
                    continue
            if not words.isdisjoint(
                part.lower() for part in re.findall(r"[A-Z]?[a-z]+|[A-Z]+", STANDARD.sub("", name))
            ):
                yield path, name


def dialect_sentences() -> Iterator[tuple[Path, str]]:
    """Yield each sentence of a docstring, comment or page that breaks a rule."""
    for path in _sources():
        for text in _texts(path.read_text()):
            yield from ((path, sentence) for sentence in _broken(text))
    for page in PAGES:
        for path in sorted((ROOT / page).rglob("*.md")) if (ROOT / page).is_dir() else [ROOT / page]:
            text = re.sub(r"^```.*?^```$|<!--.*?-->", "", path.read_text(), flags=re.DOTALL | re.MULTILINE)
            text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", text)
            prose = re.sub(r"^(?:\||#).*$", "\n", text, flags=re.MULTILINE)
            yield from ((path, sentence) for sentence in _broken(prose))


def _sources() -> Iterator[Path]:
    for folder in FOLDERS:
        yield from sorted((ROOT / folder).rglob("*.py"))


def _texts(source: str) -> Iterator[str]:
    """Yield docstrings without their examples, and comments."""
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Expr(value=ast.Constant(value=str(text))):
                yield TABLE.sub("\n", re.sub(r"^ *>>> .*", "", text, flags=re.DOTALL | re.MULTILINE))
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.string.lstrip("# ")


def _broken(text: str) -> Iterator[str]:
    for paragraph in re.split(r"\n\s*\n|\n\s*(?:[-*]|\d+\.) |\n\s*\w+: ", text):
        for sentence in SENTENCE_END.split(" ".join(paragraph.split())):
            if len(sentence.split()) > WORDS_MAX or BEGINNING.match(sentence) or PHRASE.search(sentence):
                yield sentence


if __name__ == "__main__":
    for found in (*dialect_names(), *dialect_sentences()):
        sys.stdout.write(f"{found[0].relative_to(ROOT)}: {found[1]}\n")
