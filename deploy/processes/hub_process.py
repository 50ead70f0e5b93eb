"""`robrain hub`: the Zenoh router of a team, in a process of its own."""

from contextlib import closing

from robrain.deploy.processes.live_process import LiveStop, open_hub, tell
from robrain.protocol.wire.session import listening_at

READY_PREFIX = "hub: "


def hub_command(listen: str | None) -> None:
    """Route a team's messages until Ctrl-C.

    Args:
        listen: endpoint; None uses this machine's hub endpoint, or a free port if that is taken.

    Raises:
        PortTaken: another process listens at `listen`.
        WireError: it cannot be listened on.

    """
    should_stop = LiveStop()
    with closing(open_hub(listen)[0]) as session:
        where = [endpoint for endpoint in listening_at(session) if endpoint.startswith("tcp/")]
        tell(f"{READY_PREFIX}{', '.join(where) or listen}")
        should_stop.ready()
        should_stop.wait()
