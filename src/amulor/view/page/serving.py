"""Serve the page until it is stopped."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable, Iterator

import uvicorn

from amulor.errors import FormatError
from amulor.view.design.explorer import Explorer
from amulor.view.page.live import Live
from amulor.view.page.measuring import Products
from amulor.view.page.recording import Recording
from amulor.view.page.security import new_token
from amulor.view.page.server import application
from amulor.view.page.space import Space

#: What a page says on a websocket is a word or two [byte].
_LARGEST_MESSAGE = 4096
_EVERYWHERE = ("0.0.0.0", "::")


def serve(
    shown: Recording | Live | Space | Explorer,
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    announce: Callable[[str], None] = lambda address: None,
    token: str | None = None,
    products: Products | None = None,
) -> None:
    """Serve a page until Ctrl-C."""
    with contextlib.closing(_listener(host, port)) as listener:
        address, server = _server(shown, host, listener, token or new_token(), products)
        announce(address)
        with contextlib.suppress(KeyboardInterrupt):
            server.run(sockets=[listener])


@contextlib.contextmanager
def background(
    shown: Recording | Live | Space | Explorer,
    *,
    token: str | None = None,
    products: Products | None = None,
) -> Iterator[str]:
    """Serve a page beside what else runs, as in a notebook."""
    with contextlib.closing(_listener("127.0.0.1", 0)) as listener:
        address, server = _server(
            shown, "127.0.0.1", listener, token or new_token(), products
        )
        thread = threading.Thread(
            target=server.run, kwargs={"sockets": [listener]}, daemon=True
        )
        thread.start()
        try:
            yield address
        finally:
            server.should_exit = True
            thread.join(10)


def _listener(host: str, port: int) -> socket.socket:
    """Return a socket that listens; what comes before the server runs waits in it."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen(64)
    except OSError as error:
        listener.close()
        raise FormatError(
            f"{host}, port {port}, cannot be listened at: "
            f"{error.strerror or error}; leave out --port, or name another"
        ) from error
    return listener


def _server(
    shown: Recording | Live | Space | Explorer,
    host: str,
    listener: socket.socket,
    token: str,
    products: Products | None,
) -> tuple[str, uvicorn.Server]:
    """Return the address of a page and the server behind it."""
    name = socket.gethostname() if host in _EVERYWHERE else host
    in_address = f"[{name}]" if ":" in name else name
    config = uvicorn.Config(
        application(
            shown,
            token=token,
            hosts=[name],
            products=products,
            beyond=host not in ("127.0.0.1", "::1", "localhost"),
        ),
        access_log=False,
        log_level="error",
        server_header=False,
        ws="websockets-sansio",
        ws_max_size=_LARGEST_MESSAGE,
        lifespan="off",
        timeout_graceful_shutdown=1,
    )
    port = listener.getsockname()[1]
    return f"http://{in_address}:{port}/{token}/", uvicorn.Server(config)
