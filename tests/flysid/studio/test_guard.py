"""Attacks that a local server must refuse, each sent to a real one."""

from __future__ import annotations

import asyncio
import re
import socket
import time

import pytest
from starlette.responses import Response
from starlette.types import Message, Receive, Scope, Send

from flysid.studio.guard import Quiet, RequestBounds, RequestGuard
from flysid.studio.loopback import HEAD_S, Key
from tests.flysid.studio.server import Server


def with_cookie(server: Server, **headers: str) -> dict[str, str]:
    return {"Cookie": server.cookie} | {name.replace("_", "-"): value for name, value in headers.items()}


def test_without_a_token_or_with_a_wrong_one(server: Server) -> None:
    assert server.raw("GET", "/").status == 401
    assert server.raw("GET", "/api/1/flights").status == 401
    assert server.raw("GET", "/?token=" + "a" * 32).status == 401
    assert server.raw("GET", "/api/1/flights", headers={"Cookie": f"flysid-{server.port}=x"}).status == 401
    assert server.raw("GET", "/api/1/flights", headers={"Cookie": 'a="'}).status == 401
    assert server.raw("GET", "/api/1/jobs/x/events").status == 401  # an event stream, too


def test_the_token_becomes_a_strict_cookie_and_leaves_the_address(server: Server) -> None:
    answer = server.raw("GET", "/?token=" + server.token)
    assert (answer.status, answer.headers["location"]) == (303, "/")
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert f"flysid-{server.port}=" in cookie


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1", "127.0.0.1:1", "evil.example:{port}", ""])
def test_another_host_name(server: Server, host: str) -> None:
    headers = with_cookie(server, Host=host.format(port=server.port))
    assert server.raw("GET", "/api/1/flights", headers=headers).status == 421


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "https://127.0.0.1:{port}"},
        {"Sec_Fetch_Site": "cross-site"},
        {"Sec_Fetch_Site": "same-site"},
    ],
)
def test_another_site(server: Server, headers: dict[str, str]) -> None:
    sent = with_cookie(server, **{k: v.format(port=server.port) for k, v in headers.items()})
    assert server.raw("GET", "/api/1/flights", headers=sent).status == 403
    assert server.raw("POST", "/api/1/fits", b"{}", sent).status == 403


def test_its_own_page_may(server: Server) -> None:
    sent = with_cookie(server, Origin=f"http://127.0.0.1:{server.port}", Sec_Fetch_Site="same-origin")
    assert server.raw("GET", "/api/1/flights", headers=sent).status == 200


@pytest.mark.parametrize(
    "path",
    [
        "/../../etc/passwd",
        "/..%2f..%2fetc%2fpasswd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "/shared/..%2f..%2fpyproject.toml",
        "/shared/page.html.j2",
        "/api/1/flights/..%2f..%2fetc",
        "/api/1/uploads/..%2f..",
        "/api/1/comparisons/..%2f../report.html",
        "/api/1/recipes/..%2f..%2fsecret",
        "/api/1/runs/..%2f../report.html",
        "/api/1/jobs/..%2f..",
        "//etc/passwd",
    ],
)
def test_paths_that_lead_out(server: Server, path: str) -> None:
    answer = server.raw("GET", path, headers=with_cookie(server))
    assert answer.status in (400, 404)
    assert b"root:" not in answer.body


@pytest.mark.parametrize("name", ["../../secret", "/etc/passwd", "..", "a/b", "a\x00b", ".hidden/../x"])
def test_a_path_in_place_of_a_recipe_or_of_a_run(server: Server, name: str) -> None:
    secret = server.data.parent / "secret.toml"
    secret.write_text('name = "secret"')
    assert server.send("POST", "fits", {"recipe": name, "preview": True}).status == 404
    assert server.get("align", {"f": "x", "r": name, "ch": "c"}).status in (400, 404)
    assert server.send("POST", "validates", {"run": name, "preview": True}).status == 404
    made = server.send("POST", "fits", {"recipe": "px4-attitude", "name": name, "preview": True}).json
    run = made["command"].rpartition(" -o ")[2]
    assert run.startswith(f"{server.data}.studio/runs/")
    assert "/" not in run.removeprefix(f"{server.data}.studio/runs/")
    secret.unlink()


def test_a_recipe_is_judged_without_being_kept(server: Server) -> None:
    form: dict[str, object] = {
        "signals": {"u": {"unit": "deg", "max_gap_s": "inf", "sources": [{"stream": "A", "field": "x"}]}}
    }
    form |= {"name": "mine", "channels": {"c": {"inputs": ["u"], "outputs": ["u"]}}}
    found = server.send("POST", "recipes", {"form": form})
    assert found.status == 200, found.body
    assert "max_gap_s = inf" in found.json["toml"]
    assert server.send("POST", "recipes", {"toml": found.json["toml"]}).json["form"] == found.json["form"]
    for wrong in ({}, {"toml": "["}, {"form": {"signals": 5}}, {"form": {"x": None}}, {"other": 1}):
        assert server.send("POST", "recipes", wrong).status == 400, wrong
    assert not [one for one in server.get("recipes").json["recipes"] if one["own"]]


def test_oversized_and_unmeasured_bodies(server: Server) -> None:
    big = with_cookie(server, Content_Length=str(2 << 20))
    assert server.raw("POST", "/api/1/fits", None, big).status == 413
    huge = with_cookie(server, Content_Length=str(3 << 30))
    assert server.raw("POST", "/api/1/uploads?name=a.bin", None, huge).status == 413
    chunked = with_cookie(server, Transfer_Encoding="chunked")
    assert server.raw("POST", "/api/1/fits", b"2\r\n{}\r\n0\r\n\r\n", chunked).status == 411


def test_every_answer_forbids_what_it_does_not_need(server: Server) -> None:
    page = server.raw("GET", "/", headers=with_cookie(server)).body.decode()
    [script] = re.findall(r'src="(/[0-9a-f]{16}/main.js)"', page)
    for path in ("/", script, "/api/1/flights", "/api/1/nothing"):
        answer = server.raw("GET", path, headers=with_cookie(server))
        assert answer.status == (404 if "nothing" in path else 200)
        headers = answer.headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "frame-ancestors 'none'" in policy
        assert "unsafe" not in policy
        assert headers["x-content-type-options"] == "nosniff"
        kept = "private, max-age=31536000, immutable"  # assets: another version has another address
        assert headers["cache-control"] == (kept if path == script else "no-store")
        assert headers["referrer-policy"] == "no-referrer"


def test_websockets_are_closed(server: Server) -> None:
    headers = with_cookie(
        server,
        Connection="Upgrade",
        Upgrade="websocket",
        Sec_WebSocket_Version="13",
        Sec_WebSocket_Key="eA==",
    )
    assert server.raw("GET", "/api/1/flights", headers=headers).status != 101


def test_methods_that_change_are_not_get(server: Server) -> None:
    for path in ("fits", "validates", "compares", "uploads"):
        assert server.get(path).status in (404, 405)


def test_connections_that_ask_for_nothing_are_closed(server: Server) -> None:
    """Not one byte, half a request, a byte now and then, half of a second request."""
    whole = f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n\r\n".encode()
    opened = [socket.create_connection(("127.0.0.1", server.port)) for _ in range(4)]
    opened[1].sendall(whole[:20])
    opened[3].sendall(whole + whole[:20])
    began = time.monotonic()
    for connection in opened:
        connection.settimeout(0.5)
    left = list(opened)
    while left and time.monotonic() - began < 2.0 * HEAD_S:
        for connection in list(left):
            try:
                if connection is opened[2]:
                    connection.sendall(b"G")
                if not connection.recv(4096):
                    left.remove(connection)
            except TimeoutError:
                continue
            except ConnectionError:
                left.remove(connection)
    for connection in opened:
        connection.close()
    assert not left
    assert server.raw("GET", "/").status == 401


def test_a_slow_body_is_given_up() -> None:
    """A client that stops in the middle of its body gets 408 when the bound is over."""

    async def take(scope: Scope, receive: Receive, send: Send) -> None:
        message = await receive()
        status = 408 if message["type"] == "http.disconnect" else 200
        await Response(status_code=status)(scope, receive, send)

    async def never() -> Message:
        await asyncio.sleep(60)
        raise AssertionError("waited")

    sent: list[Message] = []

    async def send(message: Message) -> None:
        sent.append(message)

    key = Key(80)
    headers = [(b"host", b"127.0.0.1:80"), (b"content-length", b"9")]
    headers.append((b"cookie", f"{key.cookie}={key.token}".encode()))
    scope = {"type": "http", "method": "POST", "path": "/api/1/fits", "query_string": b"", "headers": headers}
    asyncio.run(RequestGuard(take, key, RequestBounds(seconds=0.05), Quiet())(scope, never, send))
    assert sent[0]["status"] == 408


def test_a_body_that_never_comes(server: Server) -> None:
    """The connection is left open without the body; the server goes on answering others."""
    with socket.create_connection(("127.0.0.1", server.port), timeout=60) as slow:
        slow.sendall(
            f"POST /api/1/fits HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\nCookie: {server.cookie}\r\n"
            "Content-Length: 10\r\n\r\n{".encode()
        )
        began = time.monotonic()
        assert server.get("flights").status == 200
        assert time.monotonic() - began < RequestBounds().seconds / 2.0  # did not wait for the body


def test_the_key_takes_its_own_token_alone() -> None:
    key = Key(1234)
    assert key.fits(key.token)
    assert not key.fits("")
    assert not key.fits(key.token + "x")
    assert len(key.token) * 6 >= 192
    assert Key(1234).token != key.token


def test_quiet_is_when_nobody_has_asked_for_so_long() -> None:
    async def waited() -> tuple[float, float]:
        quiet = Quiet()
        began = time.monotonic()
        asyncio.get_running_loop().call_later(0.02, quiet.answered)
        await quiet.until_answered(60.0)
        answered = time.monotonic() - began
        asyncio.get_running_loop().call_later(0.05, quiet.restart)
        await quiet.until_quiet(0.1)
        return answered, time.monotonic() - began

    answered, ended = asyncio.run(waited())
    assert 0.02 <= answered < 30.0
    assert ended >= 0.02 + 0.05 + 0.1
    asyncio.run(Quiet().until_answered(0.01))  # nobody asks: it does not wait for ever
