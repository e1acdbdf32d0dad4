"""Serves the page until it is stopped."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable

import uvicorn

from amulor.errors import FormatError
from amulor.view.page.live import Live
from amulor.view.page.recording import Recording
from amulor.view.page.security import new_token
from amulor.view.page.server import application

#: What a page says on a websocket is a word or two [byte].
_LARGEST_MESSAGE = 4096
_EVERYWHERE = ("0.0.0.0", "::")


def serve(
    shown: Recording | Live,
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    announce: Callable[[str], None] = lambda address: None,
    token: str | None = None,
) -> None:
    """Serve a page until Ctrl-C.

    Parameters
    ----------
    shown : Recording or Live
        What it shows.
    host : str
        Address to listen at; others than that of this computer let others in, who
        need the whole address with its token.
    port : int
        Port to listen at, 0 for one that is free.
    announce : callable
        Is told the address, as soon as it answers.
    token : str, optional
        First part of every path; drawn at random by default.

    Raises
    ------
    FormatError
        If the address cannot be listened at.
    """
    token = new_token() if token is None else token
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    with contextlib.closing(listener):
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((host, port))
        except OSError as error:
            raise FormatError(
                f"{host}, port {port}, cannot be listened at: "
                f"{error.strerror or error}; leave out --port, or name another"
            ) from error
        listener.listen(64)
        known = [host]
        if host in _EVERYWHERE:
            known = [socket.gethostname()]
        beyond = host not in ("127.0.0.1", "::1", "localhost")
        shown_host = known[0]
        if ":" in shown_host:
            shown_host = f"[{shown_host}]"
        address = f"http://{shown_host}:{listener.getsockname()[1]}/{token}/"
        config = uvicorn.Config(
            application(shown, token=token, hosts=known, beyond=beyond),
            access_log=False,
            log_level="error",
            server_header=False,
            ws="websockets-sansio",
            ws_max_size=_LARGEST_MESSAGE,
            lifespan="off",
            timeout_graceful_shutdown=1,
        )
        announce(address)
        with contextlib.suppress(KeyboardInterrupt):
            uvicorn.Server(config).run(sockets=[listener])
