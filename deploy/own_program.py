"""How this very robrain is called again, for the commands that hints print."""

import os
import shlex
import shutil
import sys
from pathlib import Path

NAME = "robrain"


def own_program() -> str:
    """The words for a shell in this folder that call the robrain which runs.

    `robrain` where that is what a shell finds; else the path of the script beside this Python, relative if it is below
    this folder; else Python and the module.
    """
    script = Path(sys.executable).with_name(NAME)
    found = shutil.which(NAME)
    if found is not None and (not script.exists() or os.path.samefile(found, script)):
        return NAME
    if not os.access(script, os.X_OK):
        return f"{shlex.quote(sys.executable)} -m {NAME}.cli"
    try:
        return shlex.quote(str(script.relative_to(Path.cwd())))
    except (ValueError, OSError):  # elsewhere, or this folder is gone
        return shlex.quote(str(script))
