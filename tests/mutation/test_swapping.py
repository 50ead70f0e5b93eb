"""A mutant replaces loaded functions, compiled kernels and their callers, also in child processes."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from robrain.algorithms.navigation import navigation_grid
from tests.mutation.mutant import Mutant, mutants_of
from tests.mutation.running import ROOT
from tests.mutation.scope import draw, files_in_scope

CLEARANCE = "algorithms/navigation/navigation_grid.py"
SHOW_CLEARANCE = """
from robrain.algorithms.navigation import navigation_grid
import numpy as np
print(navigation_grid.clearance_m(np.zeros((5, 9), bool), 0.1, 9.0).tolist(), flush=True)
"""
SHOW_ANGLE = """
from robrain.protocol.model import geometry
print(round(geometry.wrap_angle_rad(7.0), 3), flush=True)
"""
IN_PROCESS = f"""
import gc, subprocess, sys
from pathlib import Path
from tests.mutation.mutant import mutants_of
from tests.mutation.swapping import LoadedFunctions
from robrain.protocol.model import geometry
from robrain.algorithms.localization.scan_match import eigen
from robrain.algorithms.navigation import navigation_grid
import numpy as np
root = Path.cwd()
gc.freeze()
loaded = LoadedFunctions(root)
print("callers", [function for path, function in loaded.callers_of_kernel(({CLEARANCE!r}, "_clearance_m"))])
print("no kernel", list(loaded.callers_of_kernel(("protocol/model/geometry.py", "wrap_angle_rad"))))

def put(path, change):
    mutant = next(mutant for mutant in mutants_of(root, path) if mutant.name.endswith(change))
    loaded.put(mutant, Path(sys.argv[1]))

def show(code):
    exec(code)
    subprocess.run([sys.executable, "-c", code], check=True)

put("protocol/model/geometry.py", "2 * math.pi -> 2 / math.pi")
show({SHOW_ANGLE!r})
put("algorithms/localization/scan_match.py", "eigen::3 -> 4")
try:
    eigen(np.eye(3), np.zeros(3), np.zeros((3, 3)))
except IndexError:
    print("out of bounds", flush=True)
put({CLEARANCE!r}, "_clearance_m::1 -> 2")
show({SHOW_CLEARANCE!r})
"""


def _run(code: str, *words: str) -> list[str]:
    ran = subprocess.run(
        [sys.executable, "-c", code, *words],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    return ran.stdout.splitlines()


@pytest.mark.slow
def test_functions_and_compiled_kernels_make_the_mistake_also_in_a_child_process_and_leave_it_to_nobody(
    tmp_path: Path,
) -> None:
    """numba's cache does not tell a kernel from one with another constant; the collector leaves what is frozen alone.

    A mutated kernel that leaves its arrays raises.
    """
    callers, no_kernel, angle, child_angle, out_of_bounds, clearance, child_clearance = _run(IN_PROCESS, str(tmp_path))
    assert "'clearance_m'" in callers
    assert no_kernel == "no kernel []"
    assert angle == child_angle != "0.717"
    assert out_of_bounds == "out of bounds"
    right = str(navigation_grid.clearance_m(np.zeros((5, 9), bool), 0.1, 9.0).tolist())
    assert clearance == child_clearance != right
    assert _run(SHOW_CLEARANCE) == [right]


def test_equal_seeds_draw_equal_mutants_and_others_do_not() -> None:
    assert draw(ROOT, 20, 1, ("agent/lifecycle/access.py",)) == draw(ROOT, 20, 1, ("agent/lifecycle/access.py",))
    assert draw(ROOT, 20, 1, ("agent/lifecycle/access.py",)) != draw(ROOT, 20, 2, ("agent/lifecycle/access.py",))


def test_an_edit_changes_only_what_is_drawn_of_the_lines_it_touches(tmp_path: Path) -> None:
    functions = [f"def f{number}(x):\n    return x + {number}\n" for number in range(2, 40)]

    def drawn(text: str) -> list[str]:
        (tmp_path / "agent").mkdir(exist_ok=True)
        (tmp_path / "agent" / "file.py").write_text(text)
        subprocess.run(["git", "init", "-q", "."], cwd=tmp_path, check=True)
        subprocess.run(["git", "add", "."], cwd=tmp_path, check=True)
        return [mutant.name for mutant in draw(tmp_path, 20, 1)]

    before = drawn("".join(functions))
    after = drawn("import os\n" + "".join(functions[1:]))
    assert len(before) == len(after) == 20
    left = [name for name in before if "::f2::" not in name]
    assert set(left) <= set(after)


@pytest.mark.parametrize(
    "path", ["agent/robot_tasks.py", "coordinator/journal/journal.py", "plugins/unit/driver/driver.py"]
)
def test_what_is_dangerous_is_in_scope(path: str) -> None:
    assert path in files_in_scope(ROOT)


def test_every_file_in_scope_has_mutants_that_name_it() -> None:
    found = mutants_of(ROOT, "agent/lifecycle/access.py")
    assert found
    assert all(isinstance(mutant, Mutant) and mutant.name.startswith("agent/lifecycle/access.py::") for mutant in found)
