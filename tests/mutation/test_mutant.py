"""Mutants differ from their source in one place, can be identified again, and run."""

from pathlib import Path
from types import FunctionType

import pytest

from tests.mutation.mutant import code_of, compile_mutant, mutants_of

SOURCE = '''
"""A module."""

class Gate:
    """A class."""

    def __init__(self, limit):
        self.limit = limit
        self.count = 0

    def lets(self, value):
        """Whether a value may pass."""
        log.info("asked")
        if value < self.limit and not value == 3:
            self.count += 1
            return True
        raise ValueError(f"{value + 1} is too much")

def scaled(values, factor=2):
    return [value * factor for value in values if value > 0]
'''


def _names(tmp_path: Path) -> list[str]:
    (tmp_path / "gate.py").write_text(SOURCE)
    return [f"{mutant.function}: {mutant.change}" for mutant in mutants_of(tmp_path, "gate.py")]


def _mutated(tmp_path: Path, change: str) -> dict[str, object]:
    (tmp_path / "gate.py").write_text(SOURCE)
    (mutant,) = [mutant for mutant in mutants_of(tmp_path, "gate.py") if mutant.change == change]
    names: dict[str, object] = {}
    exec(compile_mutant(tmp_path, mutant, "gate.py"), names)
    return names


@pytest.mark.parametrize(
    "change",
    [
        "Gate.__init__: self.limit = limit -> pass",
        "Gate.lets: value < self.limit -> value <= self.limit",
        "Gate.lets: value < self.limit -> value >= self.limit",
        "Gate.lets: not value == 3 -> value == 3",
        "Gate.lets: 3 -> 4",
        "Gate.lets: self.count += 1 -> self.count -= 1",
        "Gate.lets: return True -> return None",
        "Gate.lets: value < self.limit and (not value == 3) -> value < self.limit or not value == 3",
        "scaled: value * factor -> value / factor",
        "scaled: value > 0 -> value <= 0",
    ],
)
def test_each_usual_mistake_is_made(tmp_path: Path, change: str) -> None:
    assert change in _names(tmp_path)


@pytest.mark.parametrize("text", ["A class.", "asked", "value + 1", "factor=2"])
def test_texts_logs_and_signatures_are_left_alone(tmp_path: Path, text: str) -> None:
    assert not [name for name in _names(tmp_path) if text in name.split(" -> ")[-1] and "raise" not in name]


def test_a_mutant_runs_with_its_mistake_and_no_other(tmp_path: Path) -> None:
    scaled = _mutated(tmp_path, "value * factor -> value / factor")["scaled"]
    assert callable(scaled)
    assert scaled([4, -1]) == [2.0]
    scaled = _mutated(tmp_path, "value > 0 -> value >= 0")["scaled"]
    assert callable(scaled)
    assert scaled([4, 0, -1]) == [8, 0]


def test_the_code_of_a_method_is_found_by_its_name_and_line(tmp_path: Path) -> None:
    (tmp_path / "gate.py").write_text(SOURCE)
    mutant = next(mutant for mutant in mutants_of(tmp_path, "gate.py") if mutant.function == "scaled")
    module = compile_mutant(tmp_path, mutant, "gate.py")
    names: dict[str, object] = {}
    exec(compile(SOURCE, "gate.py", "exec"), names)
    scaled = names["scaled"]
    assert isinstance(scaled, FunctionType)
    assert code_of(module, "scaled", scaled.__code__.co_firstlineno).co_name == "scaled"
    with pytest.raises(LookupError):
        code_of(module, "scaled", 1)


def test_a_mutant_of_an_edited_source_is_refused(tmp_path: Path) -> None:
    (tmp_path / "gate.py").write_text(SOURCE)
    mutant = mutants_of(tmp_path, "gate.py")[-1]
    (tmp_path / "gate.py").write_text("x = 1\n")
    with pytest.raises(LookupError):
        compile_mutant(tmp_path, mutant, "gate.py")
