"""The notebook-style example runs from its first cell to its last."""

import subprocess
import sys
from pathlib import Path

import pytest

from robrain.sim.scenarios.scenario import Scenario
from tests.waiting import PATIENCE_S

pytestmark = pytest.mark.slow

EXAMPLE = Path(__file__).parents[3] / "examples" / "notebook_run_analysis.py"


def test_the_notebook_example_looks_at_a_recording(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    Scenario.builtin("arena_small").replace(robots=2, motes=4).run(time_limit_s=3.0, record=path)
    done = subprocess.run(
        [sys.executable, str(EXAMPLE), str(path)], capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "robot_state" in done.stdout
    assert "m² known" in done.stdout
    assert path.with_suffix(".png").stat().st_size > 5000
    assert EXAMPLE.read_text().count("# %%") >= 5
