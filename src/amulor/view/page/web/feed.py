"""What a page that follows a scan is sent over its websocket."""

from __future__ import annotations

import asyncio
import contextlib
import json
import struct
from typing import Any

import numpy as np
from starlette.websockets import WebSocket, WebSocketDisconnect

from amulor.view.page.live import POLL, Live, Rows


async def follow(live: Live, socket: WebSocket) -> None:
    """Send a page what is new in a scan until the page is gone.

    Parameters
    ----------
    live : Live
        The scan.
    socket : WebSocket
        Accepted. A page that is slow gets the newest of every row, and no queue
        grows for it.

    Raises
    ------
    WebSocketDisconnect
        When the page is gone.
    """
    live.start()
    gone = asyncio.create_task(_until_gone(socket))
    sent_picture, sent_version = live.pictures, 0
    sent_status: dict[str, Any] | None = None
    try:
        while not gone.done():
            picture, status, rows = live.snapshot(sent_version)
            if picture != sent_picture:
                await socket.send_text(json.dumps({"type": "picture"}))
                sent_picture = picture
            if rows:
                for one in rows:
                    await socket.send_bytes(message_of(one))
                sent_version = rows[-1].version
            if status and status != sent_status:
                await socket.send_text(json.dumps({"type": "status", **status}))
                sent_status = status
            await asyncio.wait({gone}, timeout=POLL)
    finally:
        gone.cancel()


async def _until_gone(socket: WebSocket) -> None:
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while True:
            await socket.receive_text()


def message_of(rows: Rows) -> bytes:
    """Return a row as it travels: length of a JSON head, head, numbers of 32 bits."""
    head = json.dumps(
        {
            "type": "rows",
            "channel": rows.channel,
            "row": rows.row,
            "layers": list(rows.layers),
        }
    ).encode()
    head += b" " * (-len(head) % 4)
    numbers = [np.asarray(values, "<f4").tobytes() for values in rows.layers.values()]
    return struct.pack("<I", len(head)) + head + b"".join(numbers)
