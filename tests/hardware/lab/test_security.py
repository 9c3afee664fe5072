"""What is refused: one test for each way in."""

import contextlib
import html
import re
import shutil
import socket
import ssl
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from argon2 import PasswordHasher
from serving import (
    ADMINISTRATOR,
    OPERATOR,
    PASSWORD,
    VIEWER,
    Served,
    csrf_of,
    ended,
    scan,
    serve,
    sign_in,
    tls_files,
    until,
)
from starlette.routing import Mount

from hardware.cli.main import main
from hardware.lab.accounts import Accounts
from hardware.lab.app import make_app
from hardware.lab.badges import IDLE_S, LONGEST_S
from hardware.lab.database import Database
from hardware.lab.refusal import Refusal
from hardware.lab.server import bind, check_tls
from hardware.lab.web import LARGEST_BODY
from jaxscan.errors import InputError

SAFE = {"GET", "HEAD"}
# All that somebody who has not signed in may see.
PUBLIC = {("GET", "/sign-in"), ("POST", "/sign-in")}
# What is not read alone and yet is for everybody who has signed in: it is about themselves, how one becomes the
# operator, or measures. Whatever is not named here has to be refused to a viewer.
FOR_VIEWERS = {
    ("POST", "/sign-out"),
    ("POST", "/api/lock"),
    ("DELETE", "/api/lock"),
    ("POST", "/api/tokens"),
    ("DELETE", "/api/tokens/{number}"),
    ("POST", "/api/projects/{name}/measure"),
}
VALUES = {"number": "1", "name": "cup", "action": "abort"}


class Clock:
    """A time that the test sets."""

    def __init__(self) -> None:
        self.now_s = 1e9

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def accounts(tmp_path: Path) -> Iterator[tuple[Accounts, Clock]]:
    """Accounts whose hashes are quick, and a clock."""
    database, clock = Database(tmp_path / "lab.sqlite3"), Clock()
    made = Accounts(database, clock)
    made._hasher = PasswordHasher(time_cost=1, memory_cost=64, parallelism=1)
    made.add(OPERATOR, PASSWORD)
    yield made, clock
    database.close()


def routes(served: Served) -> Iterator[tuple[str, str, str]]:
    """Method, path as it is declared, and a path that fits, of every route there is."""
    stack = list(make_app(served.lab).routes)
    while stack:
        route = stack.pop()
        if isinstance(route, Mount):
            assert route.path == "/static", "a new mount: say in this test who may see it"
            continue
        if hasattr(route, "effective_candidates"):  # a router that was included
            stack += route.effective_candidates()
            continue
        for method in route.methods:
            path = re.sub(r"\{(\w+)\}", lambda found: VALUES[found[1]], route.path)
            yield method, route.path, path


def tried(accounts: Accounts, name: str, password: str, address: str) -> str:
    """What somebody who tries to sign in is told."""
    try:
        accounts.sign_in(name, password, address)
    except Refusal as refused:
        return str(refused)
    return ""


def test_hashes_are_argon2_and_secrets_are_digests(tmp_path: Path):
    stored = Database(tmp_path / "lab.sqlite3")
    made = Accounts(stored)
    made.add(OPERATOR, PASSWORD)
    session = made.sign_in(OPERATOR, PASSWORD, "here")
    token = made.make_token_for(OPERATOR)
    hashed = stored("SELECT hash FROM users")[0]["hash"]
    stored.close()
    assert hashed.startswith("$argon2id$")
    assert PasswordHasher().check_needs_rehash(hashed) is False
    kept = b"".join(path.read_bytes() for path in tmp_path.glob("lab.sqlite3*"))
    for secret in (PASSWORD, session, token):
        assert secret.encode() not in kept
    assert (tmp_path / "lab.sqlite3").stat().st_mode & 0o077 == 0


def test_guessing_is_slow(accounts: tuple[Accounts, Clock]):
    made, clock = accounts
    for _ in range(5):
        with pytest.raises(Refusal, match="name or password is wrong"):
            made.sign_in(OPERATOR, "wrong", "here")
    with pytest.raises(Refusal, match="too many tries") as refused:
        made.sign_in(OPERATOR, PASSWORD, "here")
    assert (refused.value.status, round(refused.value.retry_s or 0)) == (429, 300)
    # Nobody shuts somebody else out from where they are.
    assert made.sign_in(OPERATOR.upper(), PASSWORD, "there")
    clock.now_s += 301
    assert made.sign_in(OPERATOR, PASSWORD, "here")
    # One address, many names.
    said = [tried(made, f"name{i}", "wrong", "elsewhere") for i in range(31)]
    assert set(said[:30]) == {"name or password is wrong"}
    assert said[30].startswith("too many tries")
    # One name, many addresses.
    said = [tried(made, OPERATOR, "wrong", f"address {i}") for i in range(101)]
    assert [words.startswith("too many tries") for words in said].index(True) >= 90


def test_guessing_over_http(served: Served):
    client = served.client()
    statuses = [sign_in(client, VIEWER, "wrong").status_code for _ in range(6)]
    assert statuses == [401] * 5 + [429]
    last = sign_in(client, VIEWER, PASSWORD)
    assert last.status_code == 429
    assert int(last.headers["Retry-After"]) > 200
    # A name that is not there is answered as one that is.
    unknown, known = sign_in(client, "nobody", "wrong"), sign_in(client, OPERATOR, "wrong")
    words = re.compile(r'role="alert">([^<]+)<')
    assert words.findall(unknown.text) == words.findall(known.text) == ["name or password is wrong"]


def test_nobody_is_locked_out_of_their_own_browser(served: Served):
    """20 addresses with five wrong passwords each, and more of where the user is."""
    client = served.browser(OPERATOR)
    for address in [*(f"198.51.100.{i}" for i in range(20)), "127.0.0.1"]:
        for _ in range(5):
            tried(served.lab.accounts, OPERATOR, "wrong", address)
    stranger = served.client()
    assert sign_in(stranger, OPERATOR).status_code == 429
    assert sign_in(client, OPERATOR).status_code == 303
    # What a browser brings is worth something for its own account and password alone, and guessing is slow there too.
    for name, value in [(name, value) for name, value in client.cookies.items() if "known" in name]:
        stranger.cookies.set(name, value[:-1] + ("0" if value[-1] != "0" else "1"))
    assert sign_in(stranger, OPERATOR).status_code == 429
    assert [sign_in(client, OPERATOR, "wrong").status_code for _ in range(6)] == [401] * 5 + [429]


def test_a_clock_that_is_set_back(accounts: tuple[Accounts, Clock]):
    made, clock = accounts
    session = made.sign_in(OPERATOR, PASSWORD, "here")
    for _ in range(6):
        tried(made, OPERATOR, "wrong", "there")
    clock.now_s -= 86400
    # Nobody waits for a day, and no session is longer for it.
    with pytest.raises(Refusal) as refused:
        made.sign_in(OPERATOR, PASSWORD, "there")
    assert (refused.value.retry_s or 0) <= 300
    assert made.of_session(session) is not None
    clock.now_s += IDLE_S + 1
    assert made.of_session(session) is None
    clock.now_s += 301
    assert made.sign_in(OPERATOR, PASSWORD, "there")


def test_many_addresses_of_one_network_are_one(accounts: tuple[Accounts, Clock]):
    made, _ = accounts
    said = [tried(made, OPERATOR, "wrong", f"2001:db8::{i:x}") for i in range(1, 7)]
    assert said[5].startswith("too many tries")
    assert not tried(made, OPERATOR, PASSWORD, "2001:db8:1::1")


def test_so_many_sessions_and_no_more(accounts: tuple[Accounts, Clock]):
    made, clock = accounts
    tokens = []
    for _ in range(52):
        tokens.append(made.sign_in(OPERATOR, PASSWORD, "here"))
        clock.now_s += 1
    assert [made.of_session(token) is not None for token in tokens] == [False] * 2 + [True] * 50


def test_what_another_process_changes_is_seen(served: Served):
    """`scanner user`, while the server runs: a token that it makes is good at once, and one that it ends is not."""
    folder = served.lab.projects.path("x").parents[1]
    database = Database(folder / "lab.sqlite3")
    other = Accounts(database)
    client = served.client(Authorization=f"Bearer {other.make_token_for(OPERATOR)}")
    assert client.post("/api/lock", json={}).status_code == 200
    assert client.post("/api/stop").status_code == 200
    other.remove(OPERATOR)
    until(lambda: client.post("/api/stop").status_code == 401, 20)
    database.close()


def test_sessions_end(accounts: tuple[Accounts, Clock]):
    made, clock = accounts
    token = made.sign_in(OPERATOR, PASSWORD, "here")
    begun_s = clock.now_s
    while clock.now_s + IDLE_S - 60 < begun_s + LONGEST_S:
        clock.now_s += IDLE_S - 60
        assert made.of_session(token) is not None
    clock.now_s = begun_s + LONGEST_S + 1
    assert made.of_session(token) is None
    token = made.sign_in(OPERATOR, PASSWORD, "here")
    clock.now_s += IDLE_S + 1
    assert made.of_session(token) is None
    token, program = made.sign_in(OPERATOR, PASSWORD, "here"), made.make_token_for(OPERATOR)
    made.set_password(OPERATOR, "another password")
    assert made.of_session(token) is None
    assert made.of_token(program) is None


def test_session_fixation(lasting: Served):
    """A session that somebody planted is not the one that comes of signing in, and is worth nothing."""
    planted = "planted-by-somebody-else"
    client = lasting.client()
    client.cookies.set("scanner", planted)
    answer = sign_in(client, VIEWER)
    cookie = answer.headers["set-cookie"]
    assert all(word in cookie for word in ("HttpOnly", "SameSite=strict", "Path=/"))
    fresh = re.search(r"scanner=([^;]+)", cookie)
    assert fresh
    assert planted not in cookie
    thief = lasting.client()
    thief.cookies.set("scanner", planted)
    assert thief.get("/api/me").status_code == 401
    # Signing in again ends the session that there was, and so does signing out.
    first = lasting.browser(VIEWER)
    old = first.cookies["scanner"]
    assert sign_in(first, VIEWER).status_code == 303
    assert first.cookies["scanner"] != old
    thief.cookies.set("scanner", old)
    assert thief.get("/api/me").status_code == 401
    thief.cookies.set("scanner", first.cookies["scanner"])
    first.post("/sign-out", data={"csrf": csrf_of(first)})
    assert thief.get("/api/me").status_code == 401


def test_csrf(lasting: Served):
    client = lasting.browser(VIEWER)
    right = client.headers.pop("X-CSRF-Token")
    other = lasting.browser(VIEWER).headers["X-CSRF-Token"]
    for wrong in ({}, {"X-CSRF-Token": ""}, {"X-CSRF-Token": other}):
        assert client.post("/api/lock", json={}, headers=wrong).status_code == 403
        assert client.delete("/api/lock", headers=wrong).status_code == 403
    assert lasting.lab.lock.holder is None
    assert client.post("/sign-out", data={"csrf": other}).status_code == 403
    assert client.get("/api/me").status_code == 200
    assert client.post("/api/lock", json={}, headers={"X-CSRF-Token": right}).status_code == 200
    client.delete("/api/lock", headers={"X-CSRF-Token": right})
    # The sign-in form of another site.
    stranger = lasting.client()
    assert stranger.post("/sign-in", data={"name": VIEWER, "password": PASSWORD}).status_code == 403
    form = {"name": VIEWER, "password": PASSWORD, "form": "made up"}
    assert stranger.post("/sign-in", data=form, headers={"Cookie": "scanner_form=other"}).status_code == 403


@pytest.mark.parametrize(
    "name",
    [
        "..",
        ".",
        "...",
        "%2e%2e",
        "..%2f..%2flab.sqlite3",
        "%2e%2e%2f",
        "cup%00",
        "cup%2f..%2fcup",
        "..%5c..",
        "a" * 65,
        " ",
    ],
)
def test_path_traversal(lasting: Served, name: str):
    client = lasting.program(OPERATOR)
    secret = lasting.lab.projects.path("x").parents[1] / "lab.sqlite3"
    targets = [
        f"/api/projects/{name}/{tail}".rstrip("/") for tail in ("scan.zip", "cloud.ply", "points", "frames/0", "")
    ]
    for target in (*targets, f"/api/calibrations/{name}/session.zip"):
        # As it stands: a client would tidy it.
        with socket.create_connection(lasting.address, timeout=10) as line:
            request = (
                f"GET {target} HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: {client.headers['Authorization']}\r\n"
            )
            line.sendall(f"{request}Connection: close\r\n\r\n".encode())
            answer = b"".join(iter(lambda line=line: line.recv(65536), b""))
        assert re.match(rb"HTTP/1.1 (4\d\d|307)", answer), (target, answer[:200])
        assert secret.read_bytes()[:16] not in answer
    client.post("/api/lock", json={})
    for work in ({"kind": "shoot", "project": name, "step": 0}, {"kind": "calibrate", "session": name}):
        assert client.post("/api/jobs", json=work).status_code == 422
    client.delete("/api/lock")
    assert lasting.client().get(f"/static/..%2f{name}/app.py").status_code == 404


def test_what_somebody_put_into_the_folder(served: Served, tmp_path: Path):
    """A project that lists photographs of elsewhere hands none of them out; what is no folder is said to be none."""
    client, browser = served.program(ADMINISTRATOR), served.browser(VIEWER)
    client.post("/api/lock", json={})
    ended(client, client.post("/api/jobs", json=scan("cup", 1)))
    home = served.lab.projects.path("cup").parents[1]
    shutil.copy(home / "projects" / "cup" / "frames" / "0000.png", tmp_path / "secret.png")
    for name, frame in (("up", "../cup/frames/0000.png"), ("away", str(tmp_path / "secret.png")), ("link", "link.png")):
        (home / "projects" / name).mkdir()
        (home / "projects" / name / "scan.toml").write_text(f'[scan]\nframes = ["{frame}"]\nsteps = [0]\n')
        (home / "calibrations" / name).mkdir()
        board = "[board]\ninner_corners = [9, 6]\nsquare_mm = 16\n"
        (home / "calibrations" / name / "session.toml").write_text(f'{board}[views]\nboards = ["{frame}"]\n')
    for folder in ("projects", "calibrations"):
        (home / folder / "link" / "link.png").symlink_to(tmp_path / "secret.png")
        (home / folder / "file").write_text("")
        (home / folder / "elsewhere").symlink_to(tmp_path)
    shutil.copytree(home / "projects" / "cup", home / "calibrations" / "cup")
    for name in ("up", "away", "link"):
        for path in (
            "projects/{}/scan.zip",
            "projects/{}/frames/0",
            "projects/{}/cloud.ply",
            "projects/{}/points",
            "calibrations/{}/session.zip",
        ):
            answer = client.get("/api/" + path.format(name))
            assert answer.status_code == 409, path
            assert "outside of it" in answer.json()["detail"]
    for path in ("projects/file", "projects/elsewhere", "calibrations/file"):
        assert client.delete(f"/api/{path}").status_code in (404, 409)
    assert (tmp_path / "secret.png").is_file()
    assert client.post("/api/jobs", json=scan("file", 1)).status_code == 409
    assert client.post("/api/jobs", json={"kind": "calibrate", "session": "file", "stage_frames": 0}).status_code == 409
    assert {one["name"] for one in client.get("/api/calibrations").json() if not one["problem"]} == set()
    assert browser.get("/projects").status_code == 200


def test_oversize_requests(lasting: Served):
    client = lasting.program(OPERATOR)
    large = b"x" * (LARGEST_BODY + 1)
    assert client.post("/api/tokens", content=large).status_code == 413
    assert client.post("/api/tokens", content=iter([large[:1000]] * 100)).status_code == 413
    assert lasting.client().post("/sign-in", content=large).status_code == 413
    with socket.create_connection(lasting.address, timeout=10) as line:
        with contextlib.suppress(OSError):
            line.sendall(b"GET /api/me HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Long: " + b"x" * 5_000_000)
        with contextlib.suppress(ConnectionResetError):
            assert line.recv(20).startswith(b"HTTP/1.1 4")
    assert lasting.browser(OPERATOR).post("/api/tokens", json={"name": "x" * 65}).status_code == 422
    browser = lasting.client()
    form = re.search(r'name="form" value="([^"]+)"', browser.get("/sign-in").text)
    assert form
    long = browser.post("/sign-in", data={"name": "x" * 5000, "password": "y" * 20000, "form": form[1]})
    assert long.status_code == 401
    assert client.get("/api/me").status_code == 200


@pytest.mark.parametrize(
    "raw",
    [
        b"NONSENSE\r\n\r\n",
        b"GET /api/me HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: -5\r\n\r\n",
        b"POST /api/lock HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n",
        b"GET /api/me HTTP/1.1\r\nHost: 127.0.0.1\r\nHost: localhost\r\n\r\n",
        b"POST /api/stop HTTP/1.1\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\nContent-Length: 5\r\n\r\n0\r\n",
        b"GET /api/me HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer \xff\xfe\r\nConnection: close\r\n\r\n",
        b"GET /api/me HTTP/1.1\r\nHost: 127.0.0.1\r\nCookie: scanner=\xff\xfe\r\nConnection: close\r\n\r\n",
        b"POST /sign-in HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 3\r\nConnection: close\r\n\r\n\xff%f",
        b"POST /sign-in HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 40\r\nConnection: close\r\n\r\n" + b"&" * 40,
    ],
)
def test_malformed_requests(lasting: Served, raw: bytes):
    with socket.create_connection(lasting.address, timeout=10) as line:
        line.sendall(raw)
        assert re.match(rb"HTTP/1.1 4\d\d", line.recv(65536))
    client = lasting.program(OPERATOR)
    for body in (b"{", b"[]", b"null", b'{"kind": "move", "step": 1e999}', b"\xff", b"[" * 60_000):
        client.post("/api/lock", json={})
        answer = client.post("/api/jobs", content=body, headers={"Content-Type": "application/json"})
        assert answer.status_code in (400, 422)
    client.delete("/api/lock")


def test_every_route_without_a_session(lasting: Served):
    client, seen = lasting.client(), 0
    for method, declared, path in routes(lasting):
        answer = client.request(method, path)
        seen += 1
        if (method, declared) in PUBLIC:
            assert answer.status_code in (200, 403)
        elif declared.startswith("/api/"):
            assert answer.status_code == 401, (method, declared)
        else:
            assert (answer.status_code, answer.headers["Location"]) == (303, "/sign-in"), (method, declared)
        if declared.startswith("/api/"):
            wrong = client.request(method, path, headers={"Authorization": "Bearer wrong"})
            assert wrong.status_code == 401, (method, declared)
    assert seen > 30


def test_a_viewer_gives_no_orders(lasting: Served):
    program, browser, seen = lasting.program(VIEWER), lasting.browser(VIEWER), 0
    before = lasting.stage.true_position()
    for method, declared, path in routes(lasting):
        if method in SAFE or (method, declared) in PUBLIC | FOR_VIEWERS:
            continue
        seen += 1
        for client in (program, browser):
            assert client.request(method, path).status_code == 403, (method, declared)
            assert client.request(method, path, json={"kind": "home"}).status_code == 403, (method, declared)
    assert seen >= 6
    assert program.post("/api/lock", json={"take_over": True}).status_code == 200
    program.delete("/api/lock")
    assert lasting.stage.true_position() == before
    assert lasting.lab.logbook.latest() == []


def test_tokens_are_ones_own(lasting: Served):
    browser, other = lasting.browser(VIEWER), lasting.browser(OPERATOR)
    token = browser.post("/api/tokens", json={"name": "mine"}).json()["token"]
    assert lasting.client(Authorization=f"Bearer {token}").get("/api/me").json()["name"] == VIEWER
    number = browser.get("/api/tokens").json()[-1]["id"]
    assert other.delete(f"/api/tokens/{number}").status_code == 404
    # A token that was stolen makes no other, and ends none.
    program = lasting.client(Authorization=f"Bearer {token}")
    assert program.post("/api/tokens", json={"name": "another"}).status_code == 403
    assert program.delete(f"/api/tokens/{number}").status_code == 403
    assert browser.delete(f"/api/tokens/{number}").status_code == 204
    assert lasting.client(Authorization=f"Bearer {token}").get("/api/me").status_code == 401


def test_headers_of_every_answer(lasting: Served):
    client = lasting.browser(ADMINISTRATOR)
    for path in ("/", "/sign-in", "/projects", "/account", "/api", "/api/state", "/static/lab.css", "/nowhere"):
        headers = client.get(path).headers
        assert "default-src 'self'" in headers["Content-Security-Policy"]
        assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert "access-control-allow-origin" not in headers
        assert not re.search(r"""(src|href)=["'](https?:)?//""", client.get(path).text)


def test_the_interface_is_described_to_programs_too(lasting: Served):
    token = lasting.browser(OPERATOR).post("/api/tokens", json={"name": "a reader"}).json()["token"]
    answer = lasting.client(Authorization=f"Bearer {token}").get("/api")
    assert answer.status_code == 200
    assert "/api/state" in answer.text
    # What a request may have in it, of each kind of job too.
    words = html.unescape(re.sub(r"<[^>]+>", "", answer.text))
    for expected in (
        'kind "scan"',
        'kind "calibrate"',
        "apart motor steps from one to the next",
        'action "pause", "resume"',
    ):
        assert expected in words
    # Nothing of a session is in it.
    assert "csrf" not in answer.text
    assert "Sign out" not in answer.text
    wrong = lasting.client(Authorization="Bearer nonsense").get("/api")
    assert wrong.status_code == 401
    assert "token is not valid" in wrong.json()["detail"]
    # Other pages are for people alone, and who sends neither is asked to sign in.
    assert lasting.client(Authorization=f"Bearer {token}").get("/projects", follow_redirects=False).status_code == 303
    assert lasting.client().get("/api", follow_redirects=False).headers["Location"] == "/sign-in"


def test_where_it_listens(tmp_path: Path):
    for host in ("127.0.0.1", "::1", "localhost"):
        bind(host, 0, tls=False, insecure=False).close()
    for host in ("0.0.0.0", "::"):
        with pytest.raises(InputError, match="give --cert and --key"):
            bind(host, 0, tls=False, insecure=False)
        bind(host, 0, tls=True, insecure=False).close()
        bind(host, 0, tls=False, insecure=True).close()
    with pytest.raises(InputError, match="no address of this machine"):
        bind("no.such.host.invalid", 0, tls=True, insecure=False)
    with pytest.raises(InputError, match="needs both"):
        check_tls(tmp_path / "lab.pem", None)
    with pytest.raises(InputError, match="are no certificate"):
        check_tls(tmp_path / "lab.pem", tmp_path / "lab.key")


def test_the_command_refuses_to_listen_to_everybody(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["serve", "--data", str(tmp_path), "--host", "0.0.0.0", "--port", "0"]) == 2
    assert "behind a proxy that has TLS, or say --insecure" in capsys.readouterr().err
    assert main(["serve", "--data", str(tmp_path), "--port", "0"]) == 2
    assert "scanner user add NAME --admin" in capsys.readouterr().err


def test_over_tls_cookies_are_for_tls(tmp_path: Path):
    files = tls_files(tmp_path)
    served = serve(tmp_path / "lab", **files)
    context = ssl.create_default_context(cafile=files["cert"])
    with httpx.Client(base_url=served.url, verify=context, trust_env=False) as client:
        cookie = sign_in(client, VIEWER).headers["set-cookie"]
        assert "__Host-scanner=" in cookie
        assert "Secure" in cookie
        assert client.get("/api/me").json()["name"] == VIEWER
    served.end()


def test_folders_are_for_the_labs_user_alone(tmp_path: Path):
    served = serve(tmp_path / "lab")
    for folder in ("", "projects", "clouds", "calibrations"):
        assert (tmp_path / "lab" / folder).stat().st_mode & 0o077 == 0, folder
    served.end()


@pytest.mark.parametrize(
    "host", ["evil.example", "127.0.0.1.evil.example", "localhost.evil.example:80", "", "[::1", "a b"]
)
def test_a_name_of_another_site_is_refused(lasting: Served, host: str):
    client = lasting.program(OPERATOR)
    answer = client.get("/api/me", headers={"Host": host})
    assert (answer.status_code, "--name" in answer.json()["detail"]) == (421, True)
    for own in ("localhost:8003", "127.0.0.1", "[::1]:80", "192.168.1.7", socket.gethostname()):
        assert client.get("/api/me", headers={"Host": own}).status_code == 200


def test_content_length_with_transfer_encoding(lasting: Served):
    """A proxy may believe the other one of two lengths: what follows would be another request."""
    token = lasting.program(OPERATOR).headers["Authorization"]
    with socket.create_connection(lasting.address, timeout=10) as line:
        head = f"POST /api/lock HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: {token}\r\n"
        head += "Content-Type: application/json\r\n"
        line.sendall(head.encode() + b"Content-Length: 2\r\nTransfer-Encoding: chunked\r\n\r\n2\r\n{}\r\n0\r\n\r\n")
        answer = b"".join(iter(lambda: line.recv(65536), b""))
    assert re.match(rb"HTTP/1.1 400", answer)
    assert lasting.lab.lock.holder is None


def test_behind_a_proxy(tmp_path: Path):
    """Each user has limits of their own, and cookies are for TLS; what others say of themselves is not believed."""
    served = serve(tmp_path / "lab", server={"proxies": ("127.0.0.1",), "names": ("lab.example.org",)})

    def ask(address: str, password: str, said: str = "") -> httpx.Response:
        before = f"{said}, " if said else ""
        headers = {"Host": "lab.example.org", "X-Forwarded-For": before + address, "X-Forwarded-Proto": "https"}
        with served.client(**headers) as client:
            page = client.get("/sign-in")
            form = re.search(r'name="form" value="([^"]+)"', page.text)
            assert form
            cookie = page.headers["set-cookie"].split(";")[0]
            data = {"name": VIEWER, "password": password, "form": form[1]}
            return client.post("/sign-in", data=data, headers={"Cookie": cookie})

    # Whatever somebody says before the proxy's own word, the limit is theirs.
    wrong = [ask("203.0.113.5", "wrong", f"10.0.0.{i}").status_code for i in range(6)]
    assert wrong == [401] * 5 + [429]
    right = ask("203.0.113.6", PASSWORD)
    assert right.status_code == 303
    assert all("Secure" in cookie for cookie in right.headers.get_list("set-cookie") if "Max-Age=0" not in cookie)
    assert "__Host-scanner=" in right.headers["set-cookie"]
    served.end()
    # Without the option nobody is believed.
    served = serve(tmp_path / "other")
    clients = [served.client(**{"X-Forwarded-For": f"203.0.113.{i}"}) for i in range(6)]
    assert [sign_in(client, VIEWER, "wrong").status_code for client in clients] == [401] * 5 + [429]
    served.end()
