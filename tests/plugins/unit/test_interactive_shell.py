"""The shell on a robot's own terminal."""

import os
import pty
import select
import threading
from types import SimpleNamespace

import msgspec
import pytest

from robrain.agent.errors import HardwareAbsent, PluginError
from robrain.plugins.unit.interactive_shell import InteractiveShell
from robrain.protocol.wire.endpoint import Drive
from tests.waiting import PATIENCE_S, until


def shell(*, drive=Drive.LIVE, **parameters):
    command = SimpleNamespace(execute=lambda text: f"did {text}")
    env = SimpleNamespace(
        plugin="interactive_shell", robot="r1", wire=SimpleNamespace(drive=drive), use=lambda *_: command
    )
    plugin = InteractiveShell(env, msgspec.convert(parameters, InteractiveShell.Parameters))
    plugin.init()
    return plugin


def readers():
    return [thread for thread in threading.enumerate() if thread.name.startswith("terminal-")]


def said_until(keyboard, text):
    said = b""
    while text not in said:
        assert select.select([keyboard], [], [], PATIENCE_S)[0], said
        said += os.read(keyboard, 1000)


def test_commands_are_answered_until_the_plugin_is_deactivated():
    keyboard, terminal = pty.openpty()
    try:
        plugin = shell(enabled=True, terminal=os.ttyname(terminal))
        plugin.activate()
        os.write(keyboard, b"list\n")
        said_until(keyboard, b"did list\r\nr1> ")
        plugin.deactivate()
        until(lambda: not readers())  # it is not waited for without a limit
        plugin.deactivate()  # once more changes nothing
    finally:
        os.close(keyboard)
        os.close(terminal)


def test_no_terminal_is_opened_unless_enabled():
    plugin = shell(enabled=False, terminal="/nowhere")
    plugin.activate()
    plugin.deactivate()


def test_missing_terminal_is_absent_hardware():
    with pytest.raises(HardwareAbsent, match="no terminal at /nowhere: No such file"):
        shell(enabled=True, terminal="/nowhere").activate()


def test_lockstep_run_has_no_terminal():
    with pytest.raises(PluginError, match="live drive"):
        shell(drive=Drive.LOCKSTEP, enabled=True, terminal="/nowhere").activate()
