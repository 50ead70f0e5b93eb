"""A mutant replaces loaded functions, compiled kernels and their callers, also in child processes."""

import gc
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from robrain.protocol.model.navigation import clearance_kernels
from tests.mutation.mutant import Mutant, mutants_of
from tests.mutation.running import ROOT
from tests.mutation.scope import draw, files_in_scope
from tests.mutation.swapping import LoadedFunctions

IN_CHILD = """
import sys
from pathlib import Path
from tests.mutation.mutant import mutants_of
from tests.mutation.swapping import LoadedFunctions
from robrain.protocol.model import geometry
from robrain.protocol.model.navigation import clearance_kernels
from robrain.protocol.model.localization import odometry
from robrain.protocol.model.localization import scan_match_kernels
import numpy as np, subprocess
root = Path.cwd()
path, change = sys.argv[1:3]
(mutant,) = [mutant for mutant in mutants_of(root, path) if mutant.name.endswith(change)][:1]
LoadedFunctions(root).put(mutant, Path(sys.argv[3]))
exec(sys.argv[4])
"""


def _run(path: str, change: str, folder: Path, code: str) -> str:
    ran = subprocess.run(
        [sys.executable, "-c", IN_CHILD, path, change, str(folder), code],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    return ran.stdout.strip()


@pytest.mark.slow
def test_a_loaded_function_makes_the_mistake_for_all_who_imported_it_also_in_a_child_process(tmp_path: Path) -> None:
    code = "from robrain.protocol.model.geometry import wrap_angle_rad; print(round(wrap_angle_rad(7.0), 3))"
    said = _run(
        "protocol/model/geometry.py",
        "2 * math.pi -> 2 / math.pi",
        tmp_path,
        f"print(round(geometry.wrap_angle_rad(7.0), 3), flush=True)\nsubprocess.run([sys.executable, '-c', {code!r}])",
    )
    here, child = said.split()
    assert here == child != "0.717"


@pytest.mark.slow
def test_a_compiled_kernel_makes_the_mistake_too(tmp_path: Path) -> None:
    code = "print(clearance_kernels.clearance_m(np.zeros((5, 9), bool), 0.1, 9.0).tolist())"
    right = clearance_kernels.clearance_m(np.zeros((5, 9), bool), 0.1, 9.0)[2].tolist()
    said = _run("protocol/model/navigation/clearance_kernels.py", "width + 1 -> width - 1", tmp_path, code)
    assert said.startswith("[")
    assert said != str(right)


@pytest.mark.slow
def test_a_child_process_compiles_mutated_kernels_for_itself_and_leaves_them_to_nobody(tmp_path: Path) -> None:
    """numba's cache does not tell a kernel from one with another constant."""
    code = "from robrain.protocol.model.navigation import clearance_kernels; import numpy as np; {}".format(
        "print(clearance_kernels.clearance_m(np.zeros((5, 9), bool), 0.1, 9.0).tolist())"
    )
    right = clearance_kernels.clearance_m(np.zeros((5, 9), bool), 0.1, 9.0).tolist()
    unchanged = [sys.executable, "-c", code]
    path, change = "protocol/model/navigation/clearance_kernels.py", "_clearance_m::1 -> 2"
    said = _run(path, change, tmp_path, f"print(subprocess.run({unchanged!r}, capture_output=True).stdout)")
    assert said != f"b'{right}\\n'"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    after = subprocess.run(unchanged, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    assert after.stdout == f"{right}\n"


@pytest.mark.slow
def test_a_mutated_kernel_that_leaves_its_arrays_raises(tmp_path: Path) -> None:
    code = """
from robrain.protocol.model.localization.gauss_newton_kernels import eigen
try:
    eigen(np.eye(3), np.zeros(3), np.zeros((3, 3)))
except IndexError:
    print("out of bounds")
"""
    assert (
        _run("protocol/model/localization/gauss_newton_kernels.py", "eigen::3 -> 4", tmp_path, code) == "out of bounds"
    )


@pytest.mark.slow
def test_the_callers_of_a_compiled_kernel_are_known_though_the_collector_leaves_them_alone() -> None:
    gc.freeze()
    loaded = LoadedFunctions(ROOT)
    callers = set(loaded.callers_of_kernel(("protocol/model/navigation/clearance_kernels.py", "_clearance_m")))
    assert ("protocol/model/navigation/clearance_kernels.py", "clearance_m") in callers
    assert not list(loaded.callers_of_kernel(("protocol/model/geometry.py", "wrap_angle_rad")))


def test_equal_seeds_draw_equal_mutants_and_others_do_not() -> None:
    assert draw(ROOT, 20, 1, ("agent/access/exclusive_use.py",)) == draw(
        ROOT, 20, 1, ("agent/access/exclusive_use.py",)
    )
    assert draw(ROOT, 20, 1, ("agent/access/exclusive_use.py",)) != draw(
        ROOT, 20, 2, ("agent/access/exclusive_use.py",)
    )


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
    "path", ["agent/task_desk.py", "coordinator/journal/journal.py", "plugins/unit/driver/driver.py"]
)
def test_what_is_dangerous_is_in_scope(path: str) -> None:
    assert path in files_in_scope(ROOT)


def test_every_file_in_scope_has_mutants_that_name_it() -> None:
    found = mutants_of(ROOT, "agent/access/exclusive_use.py")
    assert found
    assert all(
        isinstance(mutant, Mutant) and mutant.name.startswith("agent/access/exclusive_use.py::") for mutant in found
    )
