"""The person beside the robot: told what to do, and asked what only eyes can tell."""

import math
import sys
from collections.abc import Mapping
from typing import Protocol

from robrain.deploy.processes.live_process import note


class Operator(Protocol):
    """Who stands beside the robot."""

    def prepare(self, what: str) -> None:
        """Have something done; returns when it is."""

    def choose(self, question: str, choices: Mapping[str, str], default: str) -> str:
        """Ask; returns a key of `choices`.

        Args:
            question: a sentence.
            choices: what each answer means.
            default: the answer if the person just presses Enter.

        """

    def number(self, question: str) -> float:
        """Ask for a finite number."""


class YesOperator:
    """Gives the default answers: all is done as it was said, and wheels turn as they are commanded."""

    def prepare(self, what: str) -> None:
        """As Operator."""

    def choose(self, question: str, choices: Mapping[str, str], default: str) -> str:
        """As Operator."""
        return default

    def number(self, question: str) -> float:
        """As Operator; nothing was measured."""
        return 0.0


class TerminalOperator:
    """Asks on stderr, and reads lines of stdin; raises EOFError at its end."""

    def prepare(self, what: str) -> None:
        """As Operator."""
        self._read(f"{what}, then press Enter (Ctrl-C ends) ")

    def choose(self, question: str, choices: Mapping[str, str], default: str) -> str:
        """As Operator."""
        note(question)
        for key, meaning in choices.items():
            note(f"  {key:<3} {meaning}{'  (Enter)' if key == default else ''}")
        while True:
            answer = self._read("> ").strip().lower() or default
            if answer in choices:
                return answer
            note(f"expected one of {', '.join(choices)}")

    def number(self, question: str) -> float:
        """As Operator."""
        while True:
            answer = self._read(f"{question}: ").strip()
            try:
                value = float(answer)
            except ValueError:
                value = math.nan
            if math.isfinite(value):
                return value
            note("expected a number, such as -0.015")

    def _read(self, prompt: str) -> str:
        sys.stderr.write(prompt)
        sys.stderr.flush()
        line = sys.stdin.readline()
        if not line:
            raise EOFError("the input has ended")
        return line
