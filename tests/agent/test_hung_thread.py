"""Where a thread is that does not come back from a plugin."""

import threading
import traceback
from types import FunctionType

from robrain.agent.plugin_traceback import traceback_in
from tests.waiting import PATIENCE_S

NO_LINE = b"\xf8"
"""Of a code's table of lines: one instruction that has none."""


def test_thread_at_an_instruction_without_a_line_is_found_and_told() -> None:
    begun, goes_on = threading.Event(), threading.Event()

    def hang() -> None:
        begun.set()
        goes_on.wait(PATIENCE_S)

    code = hang.__code__.replace(co_linetable=NO_LINE * (len(hang.__code__.co_code) // 2))
    thread = threading.Thread(target=FunctionType(code, globals(), closure=hang.__closure__))
    thread.start()
    try:
        assert begun.wait(PATIENCE_S)
        assert thread.ident is not None
        found = traceback_in(thread.ident, None)
        assert found is not None
        assert "in hang" in "".join(traceback.format_tb(found))
    finally:
        goes_on.set()
        thread.join()
