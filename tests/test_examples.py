"""The numbered examples run, say what they are said to say, and stay short.

`python -m tests.test_examples` puts into README.md what the first example prints.
"""

import re
import runpy
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
SCRIPTS = sorted(EXAMPLES.glob("[0-9][0-9]_*.py"))
SAYS = {
    "01_explore": [r"9\d% explored in \d+ s", "digest [0-9a-f]{16}"],  # and the README word for word
    "02_submit_tasks": [r"door +done by r\d", r"picture +done", r"corner: Done by r\d", r"queued"],
    "03_your_own_plugin": [r"loaded trip, a unit: distance_m", r"r1 has come \d\.\d+ m since"],
    "04_energy": [
        r"from visit to recharge, \d+%, \d+ J left",
        r"from recharge to visit, [4-9]\d%",  # as soon as there is enough for the posts that wait
        r"\d+ posts in \d+ rounds",
    ],
    "05_motes": [
        r"6 of 6 motes were heard",
        r"mule: done by r\d: .*'readings': \d+",
        r"warmth: done by mote:m1: .*'value'",
        r"light: done by r\d",
        r"watch: done by mote:m2: .*'rounds': \d+",
        r"r1: would take \S+ % of its energy; m1 takes",
    ],
    "06_together": [r"fetch +done by r\d", r"bring +done by r\d", r"lift +done by two robots"],
    "07_objectives": [r"energy: \d+ J, \d+ s", r"makespan: \d+ J, \d+ s", r"visit-6 to r1: \d+ J"],
    "08_your_own_task": [
        r"r1 can mow: width_m, height_m, lane_m",
        r"task mow-1 is refused: width_m: -1\.0 is less than or equal to the minimum of 0",
        r"r1: \d+ J",
        r"r2: \S.*mow",
        r"mow-\d done by r1: .*'lanes': 3",
    ],
}
"""What each prints, as patterns."""
LISTENS = EXAMPLES / "10_voice.py"
"""Runs at a live team, in tests/system/processes/test_assistant.py."""


README = EXAMPLES.parent / "README.md"
PRINTED = re.compile(r"(?<=^```text\n)\d+% explored in .*?\n(?=```$)", re.MULTILINE | re.DOTALL)
"""Output printed in the README for its script, which is that of the first example."""


def test_there_are_patterns_for_every_example_and_a_line_in_the_readme() -> None:
    assert [script.stem for script in SCRIPTS if script != LISTENS] == sorted(SAYS)
    told = re.findall(r"\]\((\d\d_\w+\.py)\)", (EXAMPLES / "README.md").read_text(encoding="utf-8"))
    assert told == [script.name for script in SCRIPTS]


@pytest.mark.slow
@pytest.mark.parametrize("script", [one for one in SCRIPTS if one != LISTENS], ids=lambda script: script.stem)
def test_example_runs_and_says_what_it_should(
    script: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(script)])
    runpy.run_path(str(script), run_name="__main__")
    said, wrong = capfd.readouterr()
    assert "Traceback" not in wrong
    if script is SCRIPTS[0]:
        assert PRINTED.findall(README.read_text(encoding="utf-8")) == [said], "python -m tests.test_examples"
    for pattern in SAYS[script.stem]:
        assert re.search(pattern, said), f"{pattern} in:\n{said}"
    if script.stem == "07_objectives":
        (energy_j, slow_s), (more_j, quick_s) = re.findall(r"(?:energy|makespan): (\d+) J, (\d+) s", said)
        assert int(energy_j) < int(more_j)
        assert int(slow_s) > int(quick_s)


if __name__ == "__main__":
    with TemporaryDirectory() as folder:
        said = subprocess.run(
            [sys.executable, str(SCRIPTS[0])], cwd=folder, stdout=subprocess.PIPE, text=True, check=True
        )
    README.write_text(PRINTED.sub(lambda _: said.stdout, README.read_text(encoding="utf-8")), encoding="utf-8")
