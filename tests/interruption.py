"""Another thread at the worst of times, without chance."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from types import FrameType, FunctionType
from typing import Any


@contextmanager
def before_line_of(function: Callable[..., Any], number: int, meanwhile: Callable[[], object]) -> Iterator[None]:
    """Have `meanwhile` called before that line of `function` is executed."""
    assert isinstance(function, FunctionType)
    lines, code = count(1), function.__code__

    def trace(frame: FrameType, event: str, _argument: Any) -> Any:
        if frame.f_code is not code:
            return None
        if event == "line" and next(lines) == number:
            meanwhile()
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        yield
    finally:
        sys.settrace(before)
