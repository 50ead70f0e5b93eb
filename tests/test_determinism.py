"""Code behind a digest uses nothing whose results vary by processor, and does not read the machine's clock."""

import ast
from collections.abc import Iterator
from functools import cache

import pytest

from tests.product import FOLDERS, ROOT

LOOKS_ON = ("dashboard", "deploy", "lab")
"""The dashboard only draws messages and sends a person's clicks; no run imports the others."""

BLAS = {
    "dot", "vdot", "inner", "matmul", "tensordot", "einsum", "vecdot", "matvec", "vecmat", "cov", "corrcoef",
    "convolve", "correlate", "polyfit", "linalg",
}  # fmt: skip
"""Functions of OpenBLAS or LAPACK, which have a version per processor. Use `small_linear_algebra`."""
VECTORISED = {
    "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "logaddexp", "logaddexp2", "power", "float_power", "cbrt",
    "tan", "arcsin", "arccos", "arctan", "arctan2", "sinh", "cosh", "tanh", "arcsinh", "arccosh", "arctanh", "angle",
    "fft", "partition", "argpartition",
}  # fmt: skip
"""Functions of NumPy, which have a version per vector unit. Use `elementary_functions`."""
SCIPY = {"ndimage", "linear_sum_assignment"}
"""Functions of SciPy that have only one version."""
EXCEPTIONS: dict[str, str] = {
    **dict.fromkeys(
        (
            f"algorithms/localization/wheel_calibration.py: {name}"
            for name in ("np.linalg", "np.einsum", "np.arctan2", "@", "scipy.spatial.cKDTree")
        ),
        "measures a robot in bring-up; no plugin of a run reads it",
    ),
    "coordinator/planning/remedies.py: scipy.ndimage.label": "numbers regions, for replies that are not recorded",
    "algorithms/mapping/zone_grid.py: scipy.ndimage.binary_dilation": "sets cells; it computes no numbers",
    "algorithms/mapping/zone_grid.py: scipy.ndimage.minimum_filter": "chooses among numbers; it computes none",
    "plugins/device/ros2/scan_reader.py: np.arctan2": "reads what a ROS 2 robot reports, in live alone",
}
"""Permitted uses as `file: name`, each with the reason."""

CLOCKS = {
    "plugins/device/ros2/link.py": "the thread of a ROS 2 node, in live alone",
    "plugins/device/ros2/ros2_base.py": "commands of a ROS 2 robot, on that thread",
    "agent/plugin_output.py": "slows down a thread that writes without end, in live",
    "agent/lifecycle/worker_pool.py": "starts and halts plugins side by side, in live",
    "agent/isolation/peer.py": "a plugin in a process of its own, refused in lockstep",
    "agent/host/live_drive.py": "the live drive",
    "agent/authoring/foreign_bench.py": "tests a process of its own, in live",
    "agent/authoring/testing.py": "ends a plugin of a test that hangs; no run uses it",
    "client/transport.py": "the live drive's client",
    "client/members.py": "waits for tokens on their way, in live",
    "coordinator/live.py": "the live drive",
    "coordinator/planning/live_planner.py": "the live drive's planner",
    "coordinator/planning/worker_main.py": "the live drive's planner",
    "recording/writer/recorder.py": "tells of a slow disk, in live",
    "plugins/unit/program.py": "refused in lockstep",
    "plugins/unit/tcp_socket.py": "refused in lockstep",
    "protocol/wire/hub.py": "tries what a router lets through, in live",
    "protocol/clock.py": "the live drive's clock",
    "protocol/workers.py": "limits the time for the end of threads, in live",
    "sim/lockstep/pacing.py": "slows a run down for who watches, and tells how long it took",
}
"""Files that import `time`, and why no run in lockstep depends on it."""


@cache
def sources() -> dict[str, ast.Module]:
    paths = (path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))
    names = ((str(path.relative_to(ROOT)), path) for path in paths)
    return {
        name: ast.parse(path.read_text(encoding="utf-8"))
        for name, path in sorted(names)
        if not name.startswith(LOOKS_ON)
    }


def varying(tree: ast.AST) -> Iterator[str]:
    """Names used by a source file whose results vary by processor."""
    for node in ast.walk(tree):
        match node:
            case ast.BinOp(op=ast.MatMult()) | ast.AugAssign(op=ast.MatMult()):
                yield "@"
            case ast.Attribute(value=ast.Name(id="np" | "numpy"), attr=name) if name in BLAS | VECTORISED:
                yield f"np.{name}"
            case ast.Call(func=ast.Attribute(attr="dot" as name)):
                yield f".{name}()"
            case ast.Call(func=ast.Attribute(attr="argsort"), keywords=given):
                kinds = [
                    word.value.value for word in given if word.arg == "kind" and isinstance(word.value, ast.Constant)
                ]
                if kinds not in (["stable"], ["mergesort"]):  # kernels have only the latter name
                    yield "argsort without kind='stable'"
            case ast.ImportFrom(module=str(module), names=names) if module.split(".")[0] in ("numpy", "scipy"):
                allowed = SCIPY if module.startswith("scipy") else {name.name for name in names} - BLAS - VECTORISED
                if module.startswith("numpy.linalg"):
                    allowed = set()
                yield from (f"{module}.{name.name}" for name in names if name.name not in allowed)
            case ast.Import(names=names):
                yield from (name.name for name in names if name.name.startswith(("scipy", "numpy.linalg", "numpy.fft")))
            case ast.keyword(arg="fastmath" | "parallel" as name, value=ast.Constant(value=value)) if value:
                yield name
            case _:
                pass


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("a @ b", "@"),
        ("a @= b", "@"),
        ("np.linalg.solve(a, b)", "np.linalg"),
        ("np.dot(a, b)", "np.dot"),
        ("a.dot(b)", ".dot()"),
        ("np.einsum('ii', a)", "np.einsum"),
        ("np.exp(a)", "np.exp"),
        ("np.arctan2(a, b)", "np.arctan2"),
        ("np.argsort(a)", "argsort without kind='stable'"),
        ("a.argsort()", "argsort without kind='stable'"),
        ("from numpy.linalg import eigh", "numpy.linalg.eigh"),
        ("from numpy import linalg", "numpy.linalg"),
        ("from scipy.optimize import minimize", "scipy.optimize.minimize"),
        ("import scipy.linalg", "scipy.linalg"),
        ("njit(fastmath=True)(f)", "fastmath"),
    ],
)
def test_what_varies_by_processor_is_found(line: str, what: str) -> None:
    assert what in list(varying(ast.parse(line)))


@pytest.mark.slow
def test_what_a_digest_depends_on_uses_nothing_that_varies_by_processor() -> None:
    found = {f"{name}: {what}" for name, tree in sources().items() for what in varying(tree)}
    assert found == set(EXCEPTIONS)


@pytest.mark.slow
def test_only_what_is_not_for_lockstep_reads_the_clock_of_the_machine() -> None:
    found = {
        name
        for name, tree in sources().items()
        for node in ast.walk(tree)
        if (isinstance(node, ast.Import) and any(alias.name == "time" for alias in node.names))
        or (isinstance(node, ast.ImportFrom) and node.module == "time")
    }
    assert found == set(CLOCKS)
