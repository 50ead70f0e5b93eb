"""`robrain pki …` and `robrain router`: options and output."""

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robrain.deploy.command_line.command_group import SET_UP, START, CommandApp
from robrain.deploy.command_line.output import print_result
from robrain.deploy.errors import UsageError

if TYPE_CHECKING:
    from robrain.deploy.pki.issuing import IssuedCertificate
    from robrain.protocol.access.member import Member

pki_app = CommandApp(SET_UP, "pki", "Make the certificates of a secured team.")

PkiOption = Annotated[Path, typer.Option("--pki", help="Folder of the CA.")]
RoleArgument = Annotated[
    str, typer.Argument(help="router, coordinator, operator, viewer, recorder, dashboard, robot or arena.")
]
NameArgument = Annotated[str, typer.Argument(help="Name of the robot, person or process.")]
OtherTeamOption = Annotated[str | None, typer.Option("--team", help="Name of the team; default: the CA's.")]
DaysOption = Annotated[float | None, typer.Option(help="Life of the certificate; default: 7, or as long as the last.")]
DEFAULT_PKI = Path("pki")


@pki_app.command()
def init(
    folder: Annotated[Path, typer.Argument(help="New folder for the CA.")] = DEFAULT_PKI,
    team: Annotated[str, typer.Option(help="Name of the team.")] = "default",
) -> None:
    """Make a CA for a team."""
    from robrain.deploy.pki import issuing

    issuing.init(folder, team, datetime.now(UTC))
    print_result(f"{folder}: CA of team {team}; keep {folder / 'ca.key'} where no robot is")


@pki_app.command()
def issue(
    role: RoleArgument,
    name: NameArgument,
    pki: PkiOption = DEFAULT_PKI,
    team: OtherTeamOption = None,
    days: DaysOption = None,
    host: Annotated[
        list[str] | None, typer.Option(help="Name or address at which a router is reached; may be repeated.")
    ] = None,
) -> None:
    """Issue a certificate, in a folder for its member."""
    from robrain.deploy.pki import issuing

    wanted = _member(pki, role, team, name)
    life = issuing.DAYS if days is None else days
    _print_issued(pki, issuing.issue(pki, wanted, datetime.now(UTC), life, host or ()))


@pki_app.command()
def renew(
    role: Annotated[str, typer.Argument(help="Role of one member; default: all whose certificates soon end.")] = "",
    name: Annotated[str, typer.Argument(help="Name of that member.")] = "",
    pki: PkiOption = DEFAULT_PKI,
    team: OtherTeamOption = None,
    days: DaysOption = None,
) -> None:
    """Issue a new certificate in place of the last one; processes take it up without a restart.

    Without a member: for all that have less than a third of their life left, but those that are revoked.
    """
    from robrain.deploy.pki import issuing

    if not role:
        if team is not None or days is not None:
            raise UsageError("--team, --days: expected ROLE and NAME beside them")
        renewed = issuing.renew_due(pki, datetime.now(UTC))
        if not renewed:
            print_result(f"{pki}: no certificate ends soon; `robrain pki show` lists them")
        for one in renewed:
            _print_issued(pki, one)
        return
    if not name:
        raise UsageError(f"expected ROLE and NAME, such as `robrain pki renew {role} NAME`, or neither")
    _print_issued(pki, issuing.renew(pki, _member(pki, role, team, name), datetime.now(UTC), days))


@pki_app.command()
def revoke(role: RoleArgument, name: NameArgument, pki: PkiOption = DEFAULT_PKI, team: OtherTeamOption = None) -> None:
    """Take a member out of the routers' rules for good."""
    from robrain.deploy.pki import issuing
    from robrain.protocol.access.member import MemberRole

    wanted = _member(pki, role, team, name)
    revoked = issuing.revoke(pki, wanted)
    if wanted.role is MemberRole.ROUTER:
        print_result(
            f"{wanted.common_name} gets no new certificate; members accept the one it has until "
            f"{revoked.not_after:%Y-%m-%d %H:%M} UTC: if its key is lost, make a new CA"
        )
        return
    print_result(
        f"{wanted.common_name} is revoked: copy members.json to the routers that run from a copy of their folder"
    )


@pki_app.command()
def show(pki: PkiOption = DEFAULT_PKI) -> None:
    """List the members, and until when their certificates last."""
    from robrain.deploy.pki.issuing import MEMBERS_FILE, read_members
    from robrain.protocol.access.identity import duration

    now = datetime.now(UTC)
    for one in read_members(pki / MEMBERS_FILE).members:
        left_s = (one.not_after - now).total_seconds()
        state = "revoked" if one.revoked else f"ends in {duration(left_s)}" if left_s > 0 else "has ended"
        print_result(f"{one.member.common_name:<40} {state:<20} {one.serial}")


router_app = CommandApp(START)


@router_app.command()
def router(
    listen: Annotated[
        str | None, typer.Option(help="Endpoint, tls/HOST:PORT; default: tls/127.0.0.1:7447, this machine alone.")
    ] = None,
    connect: Annotated[
        str | None, typer.Option(help="Endpoints of other routers of the same CA, tls/HOST:PORT, separated by commas.")
    ] = None,
) -> None:
    """Run a router that gives each certificate the permissions of its role: `robrain --tls FOLDER router`."""
    from robrain.deploy.pki.router import router_command
    from robrain.protocol.wire.hub import given_endpoints

    router_command(None, listen, given_endpoints(connect or ""))


def _member(pki: Path, role: str, team: str | None, name: str) -> "Member":
    from robrain.deploy.pki.issuing import MEMBERS_FILE, read_members
    from robrain.protocol.access.member import member

    return member(role, read_members(pki / MEMBERS_FILE).team if team is None else team, name)


def _print_issued(pki: Path, issued: "IssuedCertificate") -> None:
    from robrain.deploy.pki.issuing import folder_of

    until = f"{issued.not_after:%Y-%m-%d %H:%M} UTC"
    print_result(f"{folder_of(pki, issued.member)}: {issued.member.common_name} until {until}")
