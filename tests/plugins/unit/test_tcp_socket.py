import contextlib
import socket
import threading
from types import SimpleNamespace

import pytest

from robrain.agent.errors import PluginError
from robrain.plugins.unit import tcp_socket as server
from robrain.plugins.unit.tcp_socket import TcpSocket
from robrain.protocol.wire.endpoint import Drive
from tests.waiting import PATIENCE_S, until


class Command:
    """Answers as the plugin command does, with what it was told."""

    def __init__(self):
        self.begun = threading.Event()
        self.may_end = threading.Event()

    def execute(self, text):
        if text == "wait":
            self.begun.set()
            assert self.may_end.wait(PATIENCE_S)
        return f"ok {text}"


def tcp_socket(command=None, *, drive=Drive.LIVE, enabled=True, **parameters):
    used = command or Command()
    env = SimpleNamespace(
        robot="r1", plugin="tcp_socket", wire=SimpleNamespace(drive=drive), use=lambda name, interface: used
    )
    plugin = TcpSocket(env, TcpSocket.Parameters(enabled=enabled, **parameters))
    plugin.init()
    return plugin


@pytest.fixture
def listening():
    """Makes plugins that listen; all are closed at the end."""
    with contextlib.ExitStack() as stack:

        def listen(command=None, **parameters):
            plugin = tcp_socket(command, **parameters)
            plugin.activate()
            stack.callback(plugin.deactivate)
            return plugin

        yield listen


class Client:
    def __init__(self, plugin, host="127.0.0.1"):
        self.socket = socket.create_connection((host, plugin.port()), timeout=PATIENCE_S)
        self.lines = self.socket.makefile("rb")

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self.lines.close()
        self.socket.close()

    def send(self, data):
        self.socket.sendall(data)

    def line(self):
        return self.lines.readline()

    def ask(self, text):
        self.send(text.encode() + b"\n")
        return self.line().decode().removesuffix("\n")


def test_each_line_is_a_command_and_each_answer_a_line(listening):
    with Client(listening()) as client:
        assert client.ask("call driver stop()") == "ok call driver stop()"
        client.send(b"a\nb\n")
        assert [client.line(), client.line()] == [b"ok a\n", b"ok b\n"]


def test_a_slow_command_holds_up_nobody_else(listening):
    command = Command()
    plugin = listening(command)
    with Client(plugin) as slow, Client(plugin) as quick:
        slow.send(b"wait\n")
        assert command.begun.wait(PATIENCE_S)
        assert quick.ask("quick") == "ok quick"
        command.may_end.set()
        assert slow.line() == b"ok wait\n"


def test_many_clients_are_served_and_one_too_many_is_told_so(listening):
    plugin = listening()
    with contextlib.ExitStack() as stack:
        clients = [stack.enter_context(Client(plugin)) for _ in range(32)]
        assert [client.ask(str(number)) for number, client in enumerate(clients)] == [f"ok {n}" for n in range(32)]
        assert plugin.clients() == 32
        with Client(plugin) as refused:
            assert refused.line() == b"error busy: 32 clients are connected already\n"
            assert refused.line() == b""
    until(lambda: plugin.clients() == 0)
    with Client(plugin) as client:
        assert client.ask("again") == "ok again"


def test_a_client_without_a_command_is_cut_off_soon_and_others_stay(listening, monkeypatch):
    monkeypatch.setattr(server, "FIRST_COMMAND_S", 0.2)
    plugin = listening()
    with Client(plugin) as spoken, Client(plugin) as trickling:
        assert spoken.ask("first") == "ok first"

        def trickle() -> None:
            with contextlib.suppress(OSError):
                trickling.send(b"x")

        until(lambda: plugin.clients() == 1, step=trickle)
        assert spoken.ask("second") == "ok second"


def test_nobody_but_the_machine_itself_can_connect_unless_told(listening):
    plugin = listening()
    assert plugin._server.server_address[0] == "127.0.0.1"
    with pytest.raises(OSError):  # noqa: PT011 - refused or unreachable, as the machine likes
        Client(plugin, host="127.0.0.2")
    with Client(listening(host="0.0.0.0"), host="127.0.0.2") as client:
        assert client.ask("hello") == "ok hello"


def test_deactivation_cuts_clients_off_and_leaves_no_thread(listening):
    before = set(threading.enumerate())
    plugin = tcp_socket()
    plugin.activate()
    port = plugin.port()
    with Client(plugin) as client, Client(plugin) as cut:
        assert client.ask("x") == "ok x"
        cut.send(b"call driver dri")
        plugin.deactivate()
        assert client.line() == b""
    until(lambda: set(threading.enumerate()) <= before)  # none is waited for without a limit
    assert (plugin.port(), plugin.clients()) == (0, 0)
    plugin.deactivate()  # twice does no harm
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)


def test_a_port_that_is_taken_is_named(listening):
    taken = listening().port()
    with pytest.raises(PluginError, match=f"tcp_socket cannot listen on 127.0.0.1 port {taken}"):
        tcp_socket(port=taken).activate()


def test_in_lockstep_it_says_why_it_does_not_listen(stage):
    one = stage()
    one.host("tcp_socket", tcp_socket={"enabled": True})
    info = one.infos()["tcp_socket"]
    assert info.state == "faulted"
    assert "only in the live drive" in info.why
