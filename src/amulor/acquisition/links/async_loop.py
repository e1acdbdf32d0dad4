"""Devices whose calls are coroutines: an event loop that others call from outside."""

from __future__ import annotations

import asyncio
import concurrent.futures
import inspect
import threading
from collections.abc import Callable
from typing import Any

#: How much later than the event loop itself a caller gives up [s].
_GRACE = 5.0


class AsyncLoop:
    """An event loop in another thread.

    Parameters
    ----------
    loop : asyncio.AbstractEventLoop, optional
        One that runs in another thread already, such as that of a RunEngine; it is not
        stopped here. One of our own if left out.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop | None = None) -> None:
        self._thread: threading.Thread | None = None
        if loop is None:
            loop = asyncio.new_event_loop()
            self._thread = threading.Thread(target=loop.run_forever, daemon=True)
            self._thread.start()
        self._loop = loop

    def run(self, call: Callable[[], Any], *, timeout: float) -> Any:
        """Call something in the loop, and wait for it if it is to be waited for.

        Parameters
        ----------
        call : callable
            Without arguments; what it returns may be an awaitable or not.
        timeout : float
            How long it may take [s].

        Returns
        -------
        object
            What came of it.

        Raises
        ------
        TimeoutError
            If it takes longer; it has been cancelled then.
        """

        async def awaited() -> Any:
            async with asyncio.timeout(timeout):
                found = call()
                return await found if inspect.isawaitable(found) else found

        future = asyncio.run_coroutine_threadsafe(awaited(), self._loop)
        try:
            return future.result(timeout + _GRACE)
        except concurrent.futures.CancelledError:
            raise RuntimeError("it was cancelled by its event loop") from None
        except BaseException:
            future.cancel()
            raise

    def close(self) -> None:
        """Stop the loop if it is our own; it may be called twice."""
        thread, self._thread = self._thread, None
        if thread is None:
            return
        future = asyncio.run_coroutine_threadsafe(_end_others(), self._loop)
        future.result(_GRACE)
        self._loop.call_soon_threadsafe(self._loop.stop)
        thread.join(_GRACE)
        self._loop.close()


async def _end_others() -> None:
    """Cancel what still runs in this loop."""
    others = asyncio.all_tasks() - {asyncio.current_task()}
    for task in others:
        task.cancel()
    await asyncio.gather(*others, return_exceptions=True)
