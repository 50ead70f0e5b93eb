"""For Python processes started by tests: they run the mutated module too, or record which functions they reach.

Python imports this file at start if its folder is in PYTHONPATH. It imports nothing from the project.
"""

import importlib.machinery
import marshal
import os
import sys
import threading
from types import CodeType, FrameType
from typing import Any


def put_in_imports(path: str, code: CodeType) -> None:
    """Run this code for the module at `path` whenever it is imported from now on."""
    get_code = importlib.machinery.SourceFileLoader.get_code

    def get_mutated(self: importlib.machinery.SourceFileLoader, fullname: str) -> CodeType | None:
        if os.path.realpath(self.get_filename(fullname)) == path:
            return code
        return get_code(self, fullname)

    importlib.machinery.SourceFileLoader.get_code = get_mutated  # type: ignore[method-assign]


def compile_anew(kernels: set[tuple[str, str]]) -> None:
    """Neither load from numba's cache nor leave there these kernels: (file, qualified name).

    The cache tells functions apart by their byte code, without its constants and without what they call.
    """
    exec_module = importlib.machinery.SourceFileLoader.exec_module

    def is_one(function: Any) -> bool:
        code = function.__code__
        return (os.path.realpath(code.co_filename), code.co_qualname) in kernels

    def exec_and_patch(self: importlib.machinery.SourceFileLoader, module: Any) -> None:
        exec_module(self, module)
        if module.__name__ != "numba.core.caching":
            return
        load, save = module.Cache.load_overload, module.Cache.save_overload
        module.Cache.load_overload = lambda cache, *how: None if is_one(cache._py_func) else load(cache, *how)
        module.Cache.save_overload = lambda cache, *how: None if is_one(cache._py_func) else save(cache, *how)

    importlib.machinery.SourceFileLoader.exec_module = exec_and_patch  # type: ignore[method-assign]


class Reached:
    """The functions below a folder that ran since `clear`, as (file, qualified name of the outermost function)."""

    def __init__(self, root: str, file: str | None = None) -> None:
        self._below = root + os.sep
        self._known: set[CodeType] = set()
        self._real: dict[str, str] = {}
        self._file = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_APPEND) if file else None
        self.functions: set[tuple[str, str]] = set()

    def clear(self) -> None:
        """Start with no functions."""
        self._known.clear()
        self.functions = set()

    def start(self) -> None:
        """Trace this thread and those that it starts."""
        threading.settrace(self)
        sys.settrace(self)

    def stop(self) -> None:
        """Stop tracing."""
        sys.settrace(None)
        threading.settrace(None)  # type: ignore[arg-type]

    def __call__(self, frame: FrameType, event: str, arg: Any) -> None:
        """Trace function for calls; lines are not traced."""
        code = frame.f_code
        if code in self._known:
            return
        self._known.add(code)
        path = self._real.get(code.co_filename)
        if path is None:
            path = self._real[code.co_filename] = os.path.realpath(code.co_filename)
        if path.startswith(self._below):
            function = (path[len(self._below) :], code.co_qualname.split(".<locals>")[0])
            self.functions.add(function)
            if self._file is not None:
                os.write(self._file, ("\t".join(function) + "\n").encode())


def _begin() -> None:
    if "ROBRAIN_MUTANT" in os.environ:
        with open(os.environ["ROBRAIN_MUTANT"], "rb") as mutated:
            path, code, kernels = marshal.load(mutated)
        put_in_imports(path, code)
        if kernels:
            compile_anew(set(kernels))
    if "ROBRAIN_REACHED" in os.environ:
        root, folder = os.environ["ROBRAIN_REACHED"].split(os.pathsep)
        Reached(root, os.path.join(folder, str(os.getpid()))).start()


if __name__ == "sitecustomize":
    _begin()
