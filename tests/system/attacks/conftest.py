"""The team that the modules of this folder attack."""

from tests.system.attacks.secured_team import team

__all__ = ["team"]
