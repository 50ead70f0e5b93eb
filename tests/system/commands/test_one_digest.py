"""A run's digest does not depend on the processor: docs/decisions/0011-one-digest-on-all-processors.md."""

import json
import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy._core import _multiarray_umath

pytestmark = pytest.mark.system

RUN = Path(__file__).parents[1] / "covering_run.py"
FEATURES: dict[str, bool] = _multiarray_umath.__cpu_features__
CORE_TYPE = "Prescott"
"""A core type that OpenBLAS can be set to, without fused or wide operations."""
LIMIT_S = 540.0
VECTOR_UNITS = [name for name in _multiarray_umath.__cpu_dispatch__ if FEATURES.get(name)]
VARIABLES: dict[str, dict[str, str]] = {
    "this one": {},
    CORE_TYPE: {"OPENBLAS_CORETYPE": CORE_TYPE, "NPY_DISABLE_CPU_FEATURES": " ".join(VECTOR_UNITS)},
}
"""Environments in which the numeric libraries know the processor, and take it for another."""


@pytest.mark.timeout(600)
@pytest.mark.skipif(platform.machine() != "x86_64", reason="OpenBLAS can take an x86-64 for another, and only that")
def test_digest_is_the_same_whatever_processor_the_numeric_libraries_take_this_one_for() -> None:
    runs = {
        name: subprocess.Popen([sys.executable, str(RUN)], stdout=subprocess.PIPE, env=os.environ | variables)
        for name, variables in VARIABLES.items()
    }
    try:
        printed = {name: run.communicate(timeout=LIMIT_S)[0] for name, run in runs.items()}
    finally:
        for run in runs.values():
            run.kill()
            run.wait()
    assert {name: run.returncode for name, run in runs.items()} == dict.fromkeys(runs, 0)
    results = {name: json.loads(text) for name, text in printed.items()}
    assert [name for name, calls in results["this one"]["met"].items() if not calls] == []
    assert {name: result["digest"] for name, result in results.items()} == dict.fromkeys(
        runs, results["this one"]["digest"]
    )
    assert {name: result["found"] for name, result in results.items()} == dict.fromkeys(
        runs, results["this one"]["found"]
    )


def test_numpy_that_the_digest_may_use_is_the_same_without_vector_units() -> None:
    code = (
        "import hashlib, numpy as np; x, y = np.random.default_rng(5).normal(scale=4.0, size=(2, 3001));"
        "a = np.abs(x);"
        "results = [np.sin(x), np.cos(x), np.sqrt(a), np.hypot(x, y), x / y, x**2, x.sum(), x.mean(), x.var(),"
        "np.cumsum(x), np.linspace(x[0], x[1], 99), np.interp(x, np.sort(y), a), np.remainder(x, 6.28), np.rint(x),"
        "np.argsort(np.rint(x), kind='stable'), np.median(x), x.astype(np.float32).sum(), np.outer(x, y).sum(axis=0)];"
        "print(hashlib.sha256(b''.join(np.asarray(each).tobytes() for each in results)).hexdigest())"
    )
    digests = {
        subprocess.run(
            [sys.executable, "-c", code],
            env=os.environ | {"NPY_DISABLE_CPU_FEATURES": " ".join(units)},
            stdout=subprocess.PIPE,
            check=True,
        ).stdout
        for units in ([], VECTOR_UNITS)
    }
    assert len(digests) == 1, np.__version__
