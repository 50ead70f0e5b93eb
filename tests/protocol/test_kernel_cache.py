"""Compiled kernels are stored where the user can write, and by nobody else."""

import os
import tempfile
from pathlib import Path

import pytest
from numba import njit
from numba.core.dispatcher import Dispatcher

from robrain.protocol.kernel_cache import VARIABLE, choose_kernel_cache


@pytest.fixture(autouse=True)
def unwritable_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv(VARIABLE, "")
    monkeypatch.delenv(VARIABLE)
    monkeypatch.setenv("HOME", "/proc/nothing")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    access = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: access(path, mode) and tmp_path in Path(path).parents)
    monkeypatch.setattr(Dispatcher, "enable_caching", Dispatcher.enable_caching)


@pytest.mark.parametrize("mode", [0o777, 0o770])
def test_a_temporary_folder_that_others_can_write_is_not_used(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture, mode: int
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    folder = tmp_path / f"robrain-kernels-{os.getuid()}"
    folder.mkdir()
    folder.chmod(mode)
    choose_kernel_cache()
    assert VARIABLE not in os.environ
    assert "compiles them" in caplog.text


def test_kernels_are_compiled_in_memory_where_nothing_can_be_written(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", "/proc/nothing")
    choose_kernel_cache()
    assert "compiles them" in caplog.text
    assert type(njit(cache=True)(abs_of)._cache).__name__ == "NullCache"


def abs_of(value: float) -> float:
    return abs(value)


@pytest.mark.parametrize("variable", ["XDG_CACHE_HOME", "HOME"])
def test_the_users_cache_comes_first(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, variable: str) -> None:
    monkeypatch.setenv(variable, str(tmp_path))
    choose_kernel_cache()
    assert Path(os.environ[VARIABLE]) == tmp_path / ("robrain" if variable != "HOME" else ".cache/robrain")
