"""A scan that is going on, followed in its journal without a word to its writer."""

from __future__ import annotations

from starlette.websockets import WebSocket

from amulor.view.page.recording import Recording


class Live:
    """A scan folder."""

    recording: Recording

    async def follow(self, socket: WebSocket) -> None:
        """Send what is new."""
        raise NotImplementedError
