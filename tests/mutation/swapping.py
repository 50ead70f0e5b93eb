"""Applies a mutant to loaded code: replaces the code of functions and recompiles kernels.

A mutated kernel is recompiled, with all kernels that call it, in 1 to 7 s; the others stay compiled. Interpreted
(`NUMBA_DISABLE_JIT`) tests of scans and maps would take a hundred times as long. It is compiled with a check of bounds:
beyond an array's end it raises IndexError as Python does, instead of reading what happens to lie there.
"""

import gc
import importlib.util
import marshal
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import CodeType, FunctionType, ModuleType

from numba.core.caching import NullCache
from numba.core.dispatcher import Dispatcher

from tests.mutation.mutant import Mutant, code_of, compile_mutant

SITE = Path(__file__).parent / "site"
Function = tuple[str, str]
"""A function: file relative to the root, qualified name."""


def load_site() -> ModuleType:
    """The module that child processes import at their start."""
    spec = importlib.util.spec_from_file_location("mutation_site", SITE / "sitecustomize.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class LoadedFunctions:
    """The project's functions in this process, and which compiled kernels they call."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._real: dict[str, str | None] = {}
        self._functions: dict[Function, list[FunctionType]] = {}
        gc.unfreeze()  # what a run has told the collector to leave alone is not among its objects
        # By its type: isinstance would ask a weak proxy, whose object may be gone.
        kernels = [found for found in gc.get_objects() if issubclass(type(found), Dispatcher)]
        self._kernels = {id(kernel.py_func): kernel for kernel in kernels}
        for function in gc.get_objects():
            if type(function) is FunctionType:
                path = self._path_of(function.__code__)
                if path is not None:
                    name = function.__code__.co_qualname.split(".<locals>")[0]
                    self._functions.setdefault((path, name), []).append(function)
        self._users: dict[int, list[FunctionType]] = {}
        for functions in self._functions.values():
            for function in functions:
                for kernel in self._kernels_used_by(function):
                    self._users.setdefault(id(kernel), []).append(function)

    def put(self, mutant: Mutant, folder: Path) -> None:
        """Run the mutant from now on, in this process and its child processes.

        Raises:
            LookupError: the source no longer has this mutant.
            ValueError: the change takes away a variable of the function's closure.

        """
        real = os.path.realpath(self._root / mutant.path)
        module = compile_mutant(self._root, mutant, real)
        kernels: list[tuple[str, str]] = []
        for function in self._functions.get((mutant.path, mutant.function), []):
            if "<locals>" in function.__code__.co_qualname:
                continue
            old = function.__code__
            function.__code__ = code_of(module, mutant.function, old.co_firstlineno)
            for kernel in self._compiled_from(function):
                kernel.targetoptions["boundscheck"] = True
                kernel._cache = NullCache()
                kernel._reset_overloads()
                code = kernel.py_func.__code__
                kernels.append((os.path.realpath(code.co_filename), code.co_qualname))
        load_site().put_in_imports(real, module)
        spec = folder / f"mutant-{os.getpid()}"
        spec.write_bytes(marshal.dumps((real, module, kernels)))
        os.environ["ROBRAIN_MUTANT"] = str(spec)
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(SITE), os.environ.get("PYTHONPATH"))))

    def callers_of_kernel(self, function: Function) -> Iterator[Function]:
        """The Python functions that call a kernel, directly or through other kernels; empty for other functions."""
        for found in self._functions.get(function, []):
            if id(found) in self._kernels:
                for kernel in self._compiled_from(found):
                    for user in self._users.get(id(kernel), []):
                        path = self._path_of(user.__code__)
                        if path is not None and id(user) not in self._kernels:
                            yield path, user.__code__.co_qualname.split(".<locals>")[0]

    def _compiled_from(self, function: FunctionType) -> list[Dispatcher]:
        """The kernel compiled from this function, and all kernels that call it."""
        first = self._kernels.get(id(function))
        found: dict[int, Dispatcher] = {}
        waiting = [first] if first is not None else []
        while waiting:
            kernel = waiting.pop()
            if id(kernel) not in found:
                found[id(kernel)] = kernel
                waiting.extend(
                    self._kernels[id(user)] for user in self._users.get(id(kernel), []) if id(user) in self._kernels
                )
        return list(found.values())

    def _path_of(self, code: CodeType) -> str | None:
        if code.co_filename not in self._real:
            real = os.path.realpath(code.co_filename)
            below = f"{self._root}{os.sep}"
            self._real[code.co_filename] = real[len(below) :] if real.startswith(below) else None
        return self._real[code.co_filename]

    def _kernels_used_by(self, function: FunctionType) -> Iterator[Dispatcher]:
        names = list(_names_in(function.__code__))
        for name in names:
            value = function.__globals__.get(name)
            if isinstance(value, Dispatcher):
                yield value
            elif isinstance(value, ModuleType):
                yield from (inner for inner in (vars(value).get(n) for n in names) if isinstance(inner, Dispatcher))


def _names_in(code: CodeType) -> Iterable[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names_in(constant)
