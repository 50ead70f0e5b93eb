"""A trial import: what breaks the process that imports it must not be imported by the robot's own.

The robot reads an isolated plugin's class to know its level, interface and functions, so its module is imported there
too. Its top-level code runs first in a process that may crash or hang; what comes through that is imported.
"""

import subprocess
import sys
from pathlib import Path

from robrain.agent.isolation.process_group import how_it_ended

IMPORT = "import importlib, runpy, sys; (runpy.run_path if sys.argv[2] else importlib.import_module)(sys.argv[1])"


def try_import(module: str, file: Path | None, limit_s: float) -> str:
    """Import a module in a process of its own.

    Args:
        module: its name, if it is installed.
        file: where it lies, if it does not.
        limit_s: how long that may take.

    Returns:
        How the process came to grief; empty if it did not, also where the import has raised an error, which the
        robot's own import will tell better.

    """
    words = [str(file), "file"] if file is not None else [module, ""]
    try:
        ended = subprocess.run(
            [sys.executable, "-c", IMPORT, *words], check=False, timeout=limit_s, capture_output=True
        )
    except subprocess.TimeoutExpired:
        return f"has not come back for {limit_s:g} s"
    return how_it_ended(ended.returncode) if ended.returncode < 0 else ""
