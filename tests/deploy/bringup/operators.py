"""Persons beside a robot, for tests."""

from collections.abc import Callable, Mapping

from robrain.deploy.bringup.findings import Operator


class Watcher(Operator):
    """Answers as a function of the question says; notes what it was told to do."""

    def __init__(self, answer: Callable[[str, str], str] = lambda question, default: default) -> None:
        self._answer = answer
        self.told: list[str] = []
        self.asked: list[str] = []
        self.numbers: list[float] = []

    def prepare(self, what: str) -> None:
        self.told.append(what)

    def choose(self, question: str, choices: Mapping[str, str], default: str) -> str:
        self.asked.append(question)
        answer = self._answer(question, default)
        assert answer in choices
        return answer

    def number(self, question: str) -> float:
        self.asked.append(question)
        return self.numbers.pop(0)
