import os
import signal
import socket

import pytest
import zenoh

from robrain.protocol.errors import NobodyThere, PortInUse, WireError
from robrain.protocol.wire.hub import nobody_answers
from robrain.protocol.wire.session import check_endpoint, open_lockstep_session, open_session
from tests.own_hub import OwnHub


@pytest.fixture
def taken_port():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        yield other.getsockname()[1]


@pytest.fixture
def free_port():
    with OwnHub() as held:  # keeps the port, so that no other process can listen there
        yield held.port


def test_a_taken_port_is_said_in_a_sentence(taken_port):
    with pytest.raises(PortInUse, match=rf"another process listens on tcp/127.0.0.1:{taken_port}; give another"):
        open_session(mode="router", listen=[f"tcp/127.0.0.1:{taken_port}"])


def test_nobody_there_is_said_in_a_sentence(free_port):
    with pytest.raises(NobodyThere, match=rf"nobody answers at tcp/127.0.0.1:{free_port}: is `robrain up`"):
        open_session(connect=[f"tcp/127.0.0.1:{free_port}"], wait_s=0.2)


def test_what_accepts_connections_and_does_not_speak_zenoh_may_be_a_secured_team(taken_port):
    with pytest.raises(
        NobodyThere, match=rf"what listens at tcp/127.0.0.1:{taken_port} does not answer in plain Zenoh"
    ):
        open_session(connect=[f"tcp/127.0.0.1:{taken_port}"], wait_s=0.2)


def test_a_client_without_an_endpoint_is_told_how_to_give_one():
    with pytest.raises(WireError, match=r"--connect tcp/HOST:PORT or set ROBRAIN_CONNECT"):
        open_session()


@pytest.mark.parametrize(
    "endpoint",
    [
        "",  # nothing
        "127.0.0.1:7447",  # no protocol
        "localhost",  # a host alone
        "http://127.0.0.1:7447",  # another kind of address
        "tcp:127.0.0.1:7447",  # a colon for the slash
        "tcp/",  # a protocol alone
        " tcp/127.0.0.1:7447",  # a space before it
    ],
)
def test_what_is_no_endpoint_is_refused_with_an_example_of_one(endpoint):
    for options in ({"connect": [endpoint]}, {"mode": "router", "listen": [endpoint]}):
        with pytest.raises(WireError, match=r"is not an endpoint: expected something like tcp/127.0.0.1:7447"):
            open_session(**options)


@pytest.mark.parametrize(
    ("endpoint", "why"),
    [("tcp/127.0.0.1", "has no port"), ("tls/[::1]", "has no port"), ("udp/10.0.0.1:65536", "a port from 0 to 65535")],
)
def test_a_missing_and_an_impossible_port_are_named(endpoint, why):
    with pytest.raises(WireError, match=why):
        check_endpoint(endpoint)


@pytest.mark.parametrize(
    ("endpoint", "why"),
    [
        ("tcp/127.0.0.1:99999", "a port from 0 to 65535"),  # a port that does not exist
        ("tcp/192.0.2.1:7447", "cannot listen on tcp/192.0.2.1:7447"),  # another machine's address
        ("tcp/no-such-host.invalid:7447", "cannot listen on tcp/no-such-host.invalid:7447"),  # a name of nobody
    ],
)
def test_where_nobody_can_listen_is_said_in_a_sentence(endpoint, why):
    with pytest.raises(WireError, match=why):
        open_session(mode="router", listen=[endpoint])


def test_two_lockstep_sessions_in_one_machine_do_not_hear_each_other():
    one, other = open_lockstep_session(), open_lockstep_session()
    heard = []
    hear = zenoh.handlers.Callback(lambda sample: heard.append(str(sample.key_expr)), indirect=False)
    subscriber = other.declare_subscriber("robrain/**", hear)
    token = one.liveliness().declare_token("robrain/default/robot/r1/alive")
    one.put("robrain/default/halt", b"{}")
    other.put("robrain/default/own", b"{}")
    assert list(other.liveliness().get("robrain/**", timeout=1.0)) == []
    assert list(other.info.peers_zid()) == list(other.info.routers_zid()) == []
    token.undeclare()
    subscriber.undeclare()
    one.close()
    other.close()
    assert heard == ["robrain/default/own"]


def test_process_that_was_forked_after_a_session_is_refused_in_a_sentence():
    """Zenoh would wait for threads that such a process does not have."""
    open_lockstep_session().close()
    pid = os.fork()
    if not pid:
        signal.alarm(10)
        try:
            open_lockstep_session()
        except WireError as error:
            os._exit("`spawn`" not in str(error))
        os._exit(2)
    assert os.waitpid(pid, 0)[1] == 0


def test_an_unknown_host_is_named():
    assert "the host no-such-host.invalid is unknown" in nobody_answers(["tcp/no-such-host.invalid:7447"])
    assert "is unknown" not in nobody_answers(["tcp/127.0.0.1:9"])
