"""The site for nginx that is shipped: the page behind TLS and a log-in, for its own pages alone."""

import base64
import http.client
import os
import shutil
import socket
import ssl
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import pytest

from robrain.deploy.machine.machine_files import FILES
from tests.system.conftest import member_at
from tests.system.fake_team import FakeTeam
from tests.system.stepped_dashboard import Stepped
from tests.waiting import until

pytestmark = pytest.mark.system

SITE = FILES / "nginx" / "robrain-page.conf"
PASSWORD = "correct horse battery"
MAIN = """
{user}
daemon off;
pid {folder}/nginx.pid;
worker_processes 1;
events {{}}
http {{
    access_log {folder}/access.log;
    client_body_temp_path {folder}/body;
    proxy_temp_path {folder}/proxy;
    fastcgi_temp_path {folder}/fastcgi;
    uwsgi_temp_path {folder}/uwsgi;
    scgi_temp_path {folder}/scgi;
    include {folder}/site.conf;
}}
"""
WEBSOCKET = {
    "Upgrade": "websocket",
    "Connection": "Upgrade",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": base64.b64encode(b"0123456789abcdef").decode(),
}


def free_port() -> int:
    with closing(socket.socket()) as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


class Site:
    """nginx with the shipped site, only its ports and paths are others, before a dashboard."""

    def __init__(self, folder: Path, page_port: int) -> None:
        self.folder, self.port, self.plain_port = folder, free_port(), free_port()
        self.name = f"localhost:{self.port}"
        subprocess.run(
            ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2",
             "-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost",
             "-keyout", str(folder / "key.pem"), "-out", str(folder / "certificate.pem")],
            check=True, capture_output=True,
        )  # fmt: skip
        hashed = subprocess.run(
            ["openssl", "passwd", "-6", PASSWORD], check=True, capture_output=True, text=True
        ).stdout.strip()
        (folder / "users").write_text(f"ann:{hashed}\n")
        text = SITE.read_text()
        for before, after, times in (
            ("listen 443 ssl;", f"listen 127.0.0.1:{self.port} ssl;", 1),
            ("listen 80;", f"listen 127.0.0.1:{self.plain_port};", 1),
            ("127.0.0.1:8080", f"127.0.0.1:{page_port}", 4),
            ("/etc/robrain/page/", f"{folder}/", 2),
            ("auth_basic_user_file /etc/nginx/robrain.users", f"auth_basic_user_file {folder}/users", 1),
            ("page.example.org", "localhost", 2),
        ):
            assert text.count(before) == times, before
            text = text.replace(before, after)
        (folder / "site.conf").write_text(text)
        user = "user root;" if os.geteuid() == 0 else ""
        (folder / "nginx.conf").write_text(MAIN.format(folder=folder, user=user))
        self._process = subprocess.Popen(
            ["nginx", "-p", str(folder), "-e", str(folder / "error.log"), "-c", str(folder / "nginx.conf")]
        )
        until(self._is_there, "nginx does not listen")

    def _is_there(self) -> bool:
        assert self._process.poll() is None, (self.folder / "error.log").read_text()
        with closing(socket.socket()) as tried:
            return tried.connect_ex(("127.0.0.1", self.port)) == 0

    def ask(
        self, *, password: str = "", path: str = "/", origin: str = "", plain: bool = False, **headers: str
    ) -> http.client.HTTPResponse:
        """The head of an answer, as it comes."""
        trust = ssl.create_default_context(cafile=str(self.folder / "certificate.pem"))
        asking: http.client.HTTPConnection
        if plain:
            asking = http.client.HTTPConnection("localhost", self.plain_port, timeout=10.0)
        else:
            asking = http.client.HTTPSConnection("localhost", self.port, timeout=10.0, context=trust)
        if password:
            headers["Authorization"] = "Basic " + base64.b64encode(f"ann:{password}".encode()).decode()
        if origin:
            headers["Origin"] = origin
        with closing(asking):
            asking.request("GET", path, headers=headers)
            return asking.getresponse()

    def close(self) -> None:
        self._process.terminate()
        self._process.wait(10.0)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    if shutil.which("nginx") is None:
        missing = "the site before the page was not tried: there is no nginx (apt install nginx)"
        if os.environ.get("CI"):
            pytest.fail(missing)
        pytest.skip(missing)
    with ExitStack() as stack:
        team = stack.enter_context(FakeTeam())
        stepped = Stepped(stack.enter_context(member_at(team.address)))
        stack.callback(stepped.stop)
        port = int(stepped.dashboard.url.rpartition(":")[2].strip("/"))
        yield stack.enter_context(closing(Site(tmp_path_factory.mktemp("site"), port)))


@pytest.mark.parametrize("password", ["", "wrong"])
@pytest.mark.parametrize("headers", [{}, WEBSOCKET], ids=["page", "connection"])
def test_nobody_gets_in_without_the_password(site: Site, password: str, headers: dict[str, str]) -> None:
    answer = site.ask(password=password, **headers)
    assert answer.status == 401
    assert answer.headers["WWW-Authenticate"] == 'Basic realm="robrain"'


@pytest.mark.parametrize(
    "origin", ["https://evil.example", "null", "https://localhost", "https://localhost:1|localhost:1"]
)
def test_the_page_of_another_site_does_not_connect_with_a_password_that_the_browser_remembers(
    site: Site, origin: str
) -> None:
    assert site.ask(password=PASSWORD, origin=origin, **WEBSOCKET).status == 403
    assert site.ask(password=PASSWORD, origin=f"http://{site.name}", **WEBSOCKET).status == 403
    assert site.ask(password=PASSWORD, origin=f"https://{site.name}", **WEBSOCKET).status not in (401, 403)


def test_without_tls_one_is_sent_to_where_it_is(site: Site) -> None:
    answer = site.ask(plain=True, path="/x", password=PASSWORD)
    assert (answer.status, answer.headers["Location"]) == (301, "https://localhost/x")


def test_passwords_cannot_be_tried_fast(site: Site) -> None:
    """Last: the machine has to wait then."""
    said = [site.ask(password="wrong").status for _ in range(250)]
    assert said.count(429) > 50
    until(lambda: site.ask(password=PASSWORD).status == 200, "nobody gets in any more")
