"""The person at this machine, as orders name them."""

import getpass
import os
import re

from robrain.protocol.model.tasks.halt_latch import NAME_LENGTH, OPERATOR


def operator_name() -> str:
    """`operator:USER`, or `operator:uid-1000` where no account has that number."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a container's user without an account
        user = f"uid-{os.getuid()}"
    return f"{OPERATOR}:{re.sub(r'[^A-Za-z0-9_.-]', '_', user)}"[:NAME_LENGTH]
