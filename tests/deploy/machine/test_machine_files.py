"""The files for real machines are what their programs read, as far as those programs are here."""

import json
import re
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer
import zenoh

from robrain.cli import all_commands
from robrain.deploy.machine.machine_files import FILES, write_files
from robrain.protocol.wire.session import listening_at, open_session

UNITS = sorted((FILES / "systemd").glob("*.service"))
EXPOSURE_MAX = 3.0
"""Of 10, by `systemd-analyze security`; "OK" ends at 5. A unit without any hardening has 9.6."""
LOOSER = {"robrain-slcan@.service": 5.0}
"""It sets up a network of the kernel."""
PROGRAMS = ("/opt/robrain/current/bin/robrain", "/usr/bin/zenohd", "/usr/bin/slcand")


def name_of(path: Path) -> str:
    return path.name


def test_no_two_users_of_units_share_a_folder() -> None:
    """Systemd gives a unit's folders, and all in them, to its user at each start."""
    owners: dict[str, set[str]] = {}
    for unit in UNITS:
        lines = [line.partition("=") for line in unit.read_text().splitlines()]
        users = [value for key, _, value in lines if key == "User"] or ["root"]
        for key, _, value in lines:
            if key in ("StateDirectory", "CacheDirectory", "LogsDirectory", "RuntimeDirectory"):
                for folder in value.split():
                    owners.setdefault(f"{key} {folder}", set()).update(users)
    assert owners["CacheDirectory robrain"] == {"robrain"}
    assert {folder: users for folder, users in owners.items() if len(users) > 1} == {}


@pytest.fixture
def units(tmp_path: Path) -> Path:
    """The units with programs that are there."""
    if shutil.which("systemd-analyze") is None:
        pytest.skip("there is no systemd-analyze here: the units are not verified")
    for unit in (FILES / "systemd").iterdir():
        text = unit.read_text()
        for program in PROGRAMS:
            text = text.replace(program, "/bin/true")
        (tmp_path / unit.name).write_text(text)
    return tmp_path


def analyze(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["systemd-analyze", *words], capture_output=True, text=True, check=False, timeout=60)


def test_units_are_verified(units: Path) -> None:
    files = [str(path) for path in units.iterdir() if path.suffix in (".service", ".timer")]
    verified = analyze("verify", "--man=no", "--recursive-errors=no", *[_instance(units, path) for path in files])
    said = [line for line in (verified.stdout + verified.stderr).splitlines() if "robrain" in line]
    assert (verified.returncode, said) == (0, [])


def _instance(units: Path, path: str) -> str:
    """A template is verified as an instance of it."""
    if not path.endswith("@.service"):
        return path
    instance = path.replace("@.service", "@x1.service")
    shutil.copy(path, instance)
    return instance


@pytest.mark.parametrize("unit", UNITS, ids=name_of)
def test_unit_is_exposed_little(units: Path, unit: Path) -> None:
    limit = LOOSER.get(unit.name, EXPOSURE_MAX)
    judged = analyze(
        "security", "--offline=true", f"--threshold={round(limit * 10)}", "--no-pager", str(units / unit.name)
    )
    overall = [line for line in judged.stdout.splitlines() if "Overall exposure" in line]
    assert judged.returncode == 0, overall or judged.stderr


def check_words(words: list[str]) -> None:
    """Fails if the command line does not know a command or an option."""
    command = typer.main.get_command(all_commands())
    while (nested := getattr(command, "commands", {}).get(words[0])) is not None:
        command, words = nested, words[1:]
        if not words:
            break
    options = {name for parameter in command.params for name in parameter.opts}
    assert not hasattr(command, "commands"), words
    assert {word for word in words if word.startswith("-")} <= options


# -- router ---------------------------------------------------------------------------------------------------


@pytest.fixture
def router(tmp_path: Path) -> Iterator[zenoh.Session]:
    """A router with the file's settings, but for its port."""
    text = (FILES / "zenohd" / "zenohd.json5").read_text()
    config = tmp_path / "zenohd.json5"
    config.write_text(text.replace("tcp/127.0.0.1:7447", "tcp/127.0.0.1:0"))
    session = zenoh.open(zenoh.Config.from_file(str(config)))
    yield session
    session.close()


@pytest.mark.slow
def test_router_with_the_files_settings_carries_what_clients_say(router: zenoh.Session) -> None:
    where = next(at for at in listening_at(router) if at.startswith("tcp/127.0.0.1"))
    one, other = open_session(connect=[where]), open_session(connect=[where])
    queryable = one.declare_queryable("robrain/t/x", lambda query: query.reply("robrain/t/x", b"here"))
    replies = [
        reply.ok.payload.to_bytes() for _ in range(50) for reply in other.get("robrain/t/x", timeout=1.0) if reply.ok
    ]
    queryable.undeclare()
    one.close()
    other.close()
    assert replies
    config = json.loads(str(zenoh.Config.from_file(str(FILES / "zenohd" / "zenohd.json5"))))
    assert config["scouting"]["multicast"]["enabled"] is False
    assert config["mode"] == "router"


# -- devices, time, logs --------------------------------------------------------------------------------------


# -- the command that writes them -----------------------------------------------------------------------------


def test_files_are_written_once_and_never_over_others(tmp_path: Path) -> None:
    written = write_files(tmp_path / "out")
    names = {str(path.relative_to(tmp_path / "out")) for path in written}
    assert {"systemd/robrain-agent@.service", "zenohd/zenohd.json5"} <= names
    assert not [name for name in names if "__pycache__" in name or name.endswith(".py")]
    with pytest.raises(FileExistsError):
        write_files(tmp_path / "out")


PAGES = Path(__file__).parents[3] / "docs" / "how-to"
MACHINES = ("robot-computer.md", "site-router.md", "operator-desk.md", "several-machines.md")
BLOCK = re.compile(r"^```(?:sh|console)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def typed(page: str) -> list[list[str]]:
    """Commands in a page's blocks, as words; without prompt and comment."""
    blocks = BLOCK.findall((PAGES / page).read_text(encoding="utf-8"))
    lines = [re.sub(r"^[#$] ", "", line) for block in blocks for line in block.splitlines()]
    return [words for line in lines for part in line.split("&&") if (words := shlex.split(part, comments=True))]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("machine") / "files"
    write_files(folder)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("page", MACHINES)
def test_commands_of_robrain_have_their_options(page: str) -> None:
    found = [words[1:] for words in typed(page) if words[0].rpartition("/")[2] == "robrain"]
    assert found or page == "site-router.md"
    for words in found:
        check_words([word for word in words if word != "…"])
