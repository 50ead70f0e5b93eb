"""`robrain assistant`: an MCP server for a team."""

import os
import secrets
import socket
import time
from contextlib import ExitStack, closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from robrain.deploy.command_line.command_group import OPERATE, CommandApp
from robrain.deploy.command_line.options import ConnectOption, TeamOption
from robrain.protocol.keys import DEFAULT_TEAM, check_name
from robrain.protocol.state_folder import state_folder

TOKEN_BYTES = 9
ID_BYTES = 4
PREFIX = "assistant"


assistant_app = CommandApp(OPERATE)


@assistant_app.command()
def assistant(
    connect: ConnectOption = None,
    team: TeamOption = DEFAULT_TEAM,
    by: Annotated[
        str | None,
        typer.Option(help="Whom it assists; default: $USER. In a secured team the certificate says who asks."),
    ] = None,
    log: Annotated[
        Path | None, typer.Option(help="Audit log, JSON lines; default: ~/.local/state/robrain/assistant.jsonl.")
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(help="Serve HTTP on this port of 127.0.0.1 instead; 0 takes a free one.", min=0, max=65535),
    ] = None,
) -> None:
    """Let a language model look at a team and ask it to work, over the Model Context Protocol (MCP)."""
    import anyio

    from robrain.client.team import Team
    from robrain.deploy.assistant.assistant import Assistant, Confirmations
    from robrain.deploy.assistant.audit_log import AuditLog
    from robrain.deploy.assistant.mcp_server import HOST, McpServer
    from robrain.deploy.command_line.output import print_message
    from robrain.protocol.access.identity import member_on

    check_name("team", team)
    who = f"{PREFIX}:{check_name('assistant', by or os.environ.get('USER', '') or 'unknown')}"
    with ExitStack() as closing_all:
        listening = None if port is None else closing_all.enter_context(closing(_listening(HOST, port)))
        audit = closing_all.enter_context(closing(AuditLog(log or state_folder() / "assistant.jsonl")))
        client = closing_all.enter_context(Team.connect(connect, team=team, by=who))
        halting = closing_all.enter_context(Team.connect(connect, team=team, by=who))
        confirmations = Confirmations(time.monotonic, lambda: secrets.token_urlsafe(TOKEN_BYTES))
        served = McpServer(
            Assistant(
                client,
                halting,
                member_on(client.transport.session),
                audit,
                confirmations,
                new_id=lambda: secrets.token_hex(ID_BYTES),
                now=lambda: datetime.now(UTC),
                elapsed_s=time.monotonic,
                warn=print_message,
            )
        )
        where = "stdin and stdout" if listening is None else f"http://{HOST}:{listening.getsockname()[1]}/mcp"
        print_message(f"assistant: of team {team} as {client.by}, on {where}; log {audit.path}")
        if listening is None:
            anyio.run(served.on_stdio)
        else:
            anyio.run(served.on_http, listening)


def _listening(host: str, port: int) -> socket.socket:
    """A socket that listens at the port, or at a free one for 0 (PortInUse if another process does)."""
    from robrain.protocol.errors import PortInUse

    try:
        return socket.create_server((host, port))
    except OSError as error:
        raise PortInUse(f"port taken: another process listens on {host}:{port}; give another, or 0") from error
