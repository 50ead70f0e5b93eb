"""Imported by the process that workers are forked from: the code of runs, and the kernels, are there once for all.

It opens no Zenoh session: forked processes would share the locks of its threads.
"""

from robrain.deploy.processes.kernels import prepare_kernels
from robrain.lab.sweep import worker

prepare_kernels(quiet=True)

__all__ = ["worker"]
