"""Who does not belong to the page is refused: by token, name, origin, size, place."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator

import httpx
import pytest
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from amulor.errors import FormatError
from amulor.view import page
from amulor.view.page import server
from amulor.view.page.security import LARGEST_BODY, host_of, new_token

TOKEN = "a-token-for-tests"


@pytest.mark.parametrize(
    "path",
    ["/", "/scene", "/another/scene", f"/{TOKEN}x/scene", f"//{TOKEN}/scene", "/%2e/"],
)
def test_without_the_token_there_is_nothing(client: TestClient, path: str) -> None:
    answer = client.get(path)
    assert answer.status_code == 404
    assert "plate" not in answer.text
    assert TOKEN not in answer.text


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "evil.example:8000",
        "127.0.0.1.evil.example",
        "",
        "10.1.2.3",
        "[::1]evil.com",
        "[::1",
        "127.0.0.1:1@evil.com",
        "127.0.0.1:port",
    ],
)
def test_a_name_that_was_let_point_here_is_refused(
    client: TestClient, host: str
) -> None:
    assert client.get(f"/{TOKEN}/scene", headers={"host": host}).status_code == 421


@pytest.mark.parametrize("host", ["127.0.0.1:8000", "localhost:8000", "[::1]:8000"])
def test_this_computer_is_let_in(client: TestClient, host: str) -> None:
    assert client.get(f"/{TOKEN}/scene", headers={"host": host}).status_code == 200


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "null",
        "http://127.0.0.1:8001",
        "https://127.0.0.1:8000",
        "http://localhost:8000",
    ],
)
def test_another_site_is_refused(client: TestClient, origin: str) -> None:
    for ask in (client.get, client.post):
        path = f"/{TOKEN}/scene" if ask == client.get else f"/{TOKEN}/measure"
        assert ask(path, headers={"origin": origin}).status_code == 403


def test_a_picture_or_script_tag_of_another_site_is_refused(client: TestClient) -> None:
    headers = {"sec-fetch-site": "cross-site"}
    assert client.get(f"/{TOKEN}/scene", headers=headers).status_code == 403


@pytest.mark.parametrize("headers", [{}, {"origin": "http://evil.example"}])
def test_a_websocket_without_the_right_origin_is_refused(
    client: TestClient, headers: dict[str, str]
) -> None:
    with (
        pytest.raises(WebSocketDisconnect) as caught,
        client.websocket_connect(
            f"/{TOKEN}/live", headers={"host": "127.0.0.1:8000", **headers}
        ),
    ):
        pass
    assert caught.value.code == 1008
    assert "Origin" in caught.value.reason or "site" in caught.value.reason


def test_long_requests_are_refused_whatever_they_say_of_their_length(
    client: TestClient,
) -> None:
    long = b" " * (LARGEST_BODY + 1)
    assert client.post(f"/{TOKEN}/measure", content=long).status_code == 413

    def parts():
        for _ in range(LARGEST_BODY // 1000 + 2):
            yield b" " * 1000

    answer = client.post(f"/{TOKEN}/measure", content=parts())
    assert answer.status_code in (400, 413, 422)
    assert "error" in answer.text


@pytest.mark.parametrize(
    "name",
    ["../server.py", "..%2fserver.py", "%2e%2e/server.py", "server.py", "/etc/passwd"],
)
def test_only_files_of_the_page_are_read(client: TestClient, name: str) -> None:
    assert client.get(f"/{TOKEN}/static/{name}").status_code == 404


@pytest.mark.parametrize("method", ["PUT", "DELETE", "PATCH"])
def test_nothing_can_be_changed(client: TestClient, method: str) -> None:
    for path in ("", "scene", "measure", "save", "live"):
        answer = client.request(method, f"/{TOKEN}/{path}")
        assert answer.status_code in (404, 405)


def test_the_policy_forbids_what_is_not_of_the_page(client: TestClient) -> None:
    for path in ("", "scene", "static/app.js"):
        headers = client.get(f"/{TOKEN}/{path}").headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "frame-ancestors 'none'" in policy
        assert "unsafe" not in policy
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert "access-control-allow-origin" not in headers


def test_beyond_this_computer_numbers_and_stated_names_are_right(
    served: Callable[..., TestClient], recording: page.Recording
) -> None:
    client = served(recording, hosts=["boat"], beyond=True)
    for host, status in (
        ("192.168.1.7:80", 200),
        ("boat:80", 200),
        ("BOAT", 200),
        ("evil.example", 421),
    ):
        answer = client.get(f"/{TOKEN}/scene", headers={"host": host})
        assert answer.status_code == status, host


def test_tokens_differ_and_names_lose_their_port() -> None:
    assert len({new_token() for _ in range(50)}) == 50
    assert len(new_token()) >= 32
    assert host_of("[::1]:80") == "::1"
    assert host_of("Boat:80") == "boat"


def test_a_port_that_is_taken_is_explained(recording: page.Recording) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(FormatError, match="cannot be listened at"):
            page.serve(recording, port=port)


def test_a_server_of_its_own_answers_at_the_address_that_it_says(
    recording: page.Recording,
) -> None:
    with page.background(recording) as address:
        assert address.startswith("http://127.0.0.1:")
        answer = httpx.get(f"{address}scene", timeout=20)
        assert answer.json()["title"] == "Plate in a small tank"
        assert "server" not in answer.headers
    with pytest.raises(httpx.ConnectError):
        httpx.get(address, timeout=20)


def test_a_connection_whose_headers_never_end_is_closed(
    recording: page.Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "_HEADER_TIME", 0.5)
    with page.background(recording) as address:
        url = httpx.URL(address)
        whole = f"GET {url.path}scene HTTP/1.1\r\nHost: {url.netloc.decode()}\r\n\r\n"
        for beginning in ("", "GET / HTTP/1.1\r\nHost: a\r\n", whole):
            with socket.create_connection((url.host, url.port), 20) as connection:
                connection.sendall(beginning.encode())
                answered = b""
                if beginning == whole:
                    while b"Plate in a small tank" not in answered:
                        answered += connection.recv(65536)
                assert closed_within(5, connection)


@pytest.mark.parametrize(
    "length", ["Content-Length: 9000", "Transfer-Encoding: chunked"]
)
@pytest.mark.parametrize("after", ["", "200", "404"])
def test_a_body_that_does_not_end_closes_the_connection(
    recording: page.Recording, monkeypatch: pytest.MonkeyPatch, length: str, after: str
) -> None:
    monkeypatch.setattr(server, "_BODY_TIME", 0.3)
    with page.background(recording) as address:
        url = httpx.URL(address)
        with socket.create_connection((url.host, url.port), timeout=20) as connection:
            if after:  # on a connection that had a response before
                path = f"{url.path}scene" if after == "200" else "/scene"
                head = f"GET {path} HTTP/1.1\r\nHost: {url.host}:{url.port}\r\n\r\n"
                connection.sendall(head.encode())
                assert after.encode() in connection.recv(65536)
            head = (
                f"POST {url.path}measure HTTP/1.1\r\nHost: {url.host}:{url.port}\r\n"
                f"Origin: http://{url.host}:{url.port}\r\n{length}\r\n\r\n"
            )
            connection.sendall(head.encode())
            assert closed_within(5, connection)


def closed_within(limit: float, connection: socket.socket) -> bool:
    """Whether a server closes a connection that sends a byte of a header at a time."""
    begin = time.monotonic()
    connection.settimeout(0.1)
    while time.monotonic() - begin < limit:
        try:
            connection.sendall(b"a")
            if not connection.recv(65536):
                return True
        except TimeoutError:
            continue
        except ConnectionError:
            return True
    return False


def test_a_request_may_take_longer_than_its_headers(
    recording: page.Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "_HEADER_TIME", 0.3)

    def slow_body() -> Iterator[bytes]:
        for byte in b"{}":
            time.sleep(0.3)
            yield bytes([byte])

    with page.background(recording) as address, httpx.Client(timeout=20) as client:
        answer = client.post(f"{address}measure", content=slow_body())
        assert answer.status_code == 422  # the empty query is explained
        time.sleep(0.4)  # beyond the limit, on the same connection
        assert client.get(f"{address}scene").status_code == 200
