"""Random words in place of every reason's sentence, and values without words, to show that nothing decides by words."""

from typing import Any

import msgspec
import numpy as np
import pytest

from robrain.protocol import reasons
from robrain.protocol.reasons import Reason

MISLEADING = (
    "reserve", "lacks 7 J", "not the energy", "waits until r1 has charged", "no visit", "it is back", "r1", "refused",
    "nobody can do it", "it is next", "has no camera", "epoch 4 is older than 5", "goes home", "", "12 %",
)  # fmt: skip
"""Such that whoever searched sentences would find what it searches for."""
MEANINGLESS = ("tohu", "wabohu", "lorem", "ipsum", "7", "")
SPOKEN = frozenset({"why", "refusal", "now", "text", "error"})
"""Fields of messages and reasons that are for people."""


def speak_at_random(monkeypatch: pytest.MonkeyPatch, seed: int, vocabulary: tuple[str, ...] = MISLEADING) -> list[str]:
    """Replace the sentences of all reasons; returns the list in which those that are said will be."""
    rng = np.random.default_rng(seed)
    said: list[str] = []

    def at_random(_reason: object) -> str:
        said.append(" ".join(vocabulary[index] for index in rng.integers(len(vocabulary), size=rng.integers(4))))
        return said[-1]

    for kind in [Reason, *reason_types()]:
        monkeypatch.setattr(kind, "__str__", at_random)
    monkeypatch.setattr(reasons, "cut", lambda *_text: at_random(None))
    return said


def reason_types(kind: type[Reason] = Reason) -> list[type[Reason]]:
    """All types of reasons, sorted by code."""
    below = [one for child in kind.__subclasses__() for one in (child, *reason_types(child))]
    return sorted(below, key=lambda one: str(one.__struct_config__.tag))


def wordless(value: Any) -> Any:
    """A message, or a part of one, without what is for people."""
    if isinstance(value, msgspec.Struct):
        value = msgspec.to_builtins(value)
    if isinstance(value, dict):
        return {name: wordless(part) for name, part in value.items() if name not in SPOKEN}
    return [wordless(part) for part in value] if isinstance(value, list | tuple) else value
