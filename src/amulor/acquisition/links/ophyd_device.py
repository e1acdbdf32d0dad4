"""Devices of ophyd-async, called from outside their event loop."""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextlib
import importlib
import inspect
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from amulor.acquisition.plugins import Wiring
from amulor.errors import InstrumentError, MissingExtraError

#: Additional timeout of the caller beyond that of the event loop [s].
_GRACE = 5.0


class AsyncLoop:
    """Event loop in a separate thread, or a loop that runs already."""

    def __init__(self, loop: asyncio.AbstractEventLoop | None = None) -> None:
        self._thread: threading.Thread | None = None
        if loop is None:
            loop = asyncio.new_event_loop()
            self._thread = threading.Thread(target=loop.run_forever, daemon=True)
            self._thread.start()
        self._loop = loop

    def run(self, call: Callable[[], Any], *, timeout: float) -> Any:
        """Call a function in the event loop, and wait for its result."""

        async def awaited() -> Any:
            async with asyncio.timeout(timeout):
                result = call()
                return await result if inspect.isawaitable(result) else result

        future = asyncio.run_coroutine_threadsafe(awaited(), self._loop)
        try:
            return future.result(timeout + _GRACE)
        except concurrent.futures.CancelledError:
            raise RuntimeError("it was canceled by its event loop") from None
        except BaseException:
            future.cancel()
            raise

    def close(self) -> None:
        """Stop the loop if it runs in its own thread; it may be called twice."""
        thread, self._thread = self._thread, None
        if thread is None:
            return
        future = asyncio.run_coroutine_threadsafe(_end_others(), self._loop)
        future.result(_GRACE)
        self._loop.call_soon_threadsafe(self._loop.stop)
        thread.join(_GRACE)
        self._loop.close()


async def _end_others() -> None:
    """Cancel all tasks of the running event loop except this one."""
    tasks = asyncio.all_tasks() - {asyncio.current_task()}
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


#: Options of every such device.
_EVERY = ("class", "arguments", "identity", "prepare")


class OphydDevice:
    """Device of ophyd-async with its parts, called from outside the event loop."""

    def __init__(
        self,
        device: Any,
        *,
        loop: AsyncLoop,
        timeout: float,
        identity: str | None = None,
    ) -> None:
        self.device, self._loop, self._timeout = device, loop, timeout
        kind = type(device)
        self._name = f"{kind.__module__}:{kind.__qualname__} {device.name}".strip()
        self._model = "" if identity is None else f", {self.value(identity)}"

    @classmethod
    def made(
        cls, part: str, wiring: Wiring, *, needed: Sequence[str], more: Sequence[str]
    ) -> OphydDevice:
        """Connect the device that a section of the devices file describes."""
        options = wiring.options
        missing = [name for name in ("class", *needed) if name not in options]
        unknown = [name for name in options if name not in (*_EVERY, *needed, *more)]
        if missing or unknown:
            raise InstrumentError(
                f"{part}.options lacks {', '.join(missing) or 'nothing'} and has "
                f"{', '.join(unknown) or 'nothing'} that is not known; needed are "
                f"class, {', '.join(needed)}"
            )
        kind = _imported(part, str(options["class"]))
        loop = AsyncLoop()
        try:
            device = loop.run(
                lambda: _connected(kind, options.get("arguments", {}), part, wiring),
                timeout=wiring.timeout,
            )
            connected = cls(
                device,
                loop=loop,
                timeout=wiring.timeout,
                identity=options.get("identity"),
            )
            for name, value in options.get("prepare", {}).items():
                connected.set(name, value)
            return connected
        except InstrumentError:
            loop.close()
            raise
        except Exception as error:  # code of another package
            loop.close()
            raise InstrumentError(
                f"the {part} {options['class']} cannot be connected: "
                f"{type(error).__name__}: {error}; check {part}.options and power"
            ) from error

    def identity(self) -> str:
        """Return class and name of the device, and its model if it has one."""
        return f"ophyd-async {self._name}{self._model}"

    def part(self, path: str) -> Any:
        """Return a part of the device by its path, such as "stage.pan" or "out.1"."""
        node = self.device
        for name in filter(None, path.split(".")):
            try:
                node = node[int(name)] if name.isdigit() else getattr(node, name)
            except (AttributeError, LookupError):
                raise InstrumentError(
                    f"{self._name} has no {path!r}; see the options of this device in "
                    "the devices file"
                ) from None
        return node

    def call(
        self, action: str, call: Callable[[], Any], *, timeout: float | None = None
    ) -> Any:
        """Run an action in the event loop; error messages contain its name."""
        limit = self._timeout if timeout is None else timeout
        try:
            return self._loop.run(call, timeout=limit)
        except InstrumentError:
            raise
        except Exception as error:  # code of another package
            text = " ".join(str(error).split())
            late = f"not done within {limit:g} s"
            raise InstrumentError(
                f"{self._name} has failed to {action}: {type(error).__name__}: "
                f"{text or late}; check device, power and network"
            ) from error

    def value(self, path: str) -> Any:
        """Return the value of a part of the device, by its path."""
        part = self.part(path)
        return self.call(f"tell its {path}", lambda: value_of(part))

    def set(self, path: str, value: Any, *, timeout: float | None = None) -> None:
        """Set the value of a part of the device, and wait for completion."""
        part = self.part(path)
        self.call(f"set {path} to {value}", lambda: part.set(value), timeout=timeout)

    def close(self) -> None:
        """Stop the event loop; it may be called twice."""
        self._loop.close()


@contextlib.contextmanager
def closed_if_it_fails(device: OphydDevice) -> Iterator[None]:
    """Close a device if the block raises an exception."""
    try:
        yield
    except BaseException:
        device.close()
        raise


def _imported(part: str, text: str) -> Any:
    module, _, name = text.partition(":")
    try:
        return getattr(importlib.import_module(module), name)
    except ImportError as error:
        if str(error.name or "").startswith(("ophyd_async", "bluesky")):
            raise MissingExtraError(
                "ophyd-async", extra="bluesky", purpose=f"a {part} by {text}"
            ) from None
        raise InstrumentError(
            f"{part}.options.class {text!r} cannot be imported: {error}"
        ) from None
    except AttributeError:
        raise InstrumentError(
            f"{module} has no {name!r}; see {part}.options.class, such as "
            "my_beamline.devices:Head"
        ) from None


async def _connected(
    kind: Any, arguments: Mapping[str, Any], part: str, wiring: Wiring
) -> Any:
    device = kind(**arguments)
    if not device.name:
        device.set_name(part)
    await device.connect(timeout=wiring.timeout)
    return device


async def done(awaitable: Any) -> Any:
    """Await a coroutine or a status until it is done."""
    return await awaitable


async def value_of(part: Any) -> Any:
    """Return the value of a signal, or of a device with a single value."""
    if hasattr(part, "get_value"):
        return await part.get_value()
    if hasattr(part, "locate"):
        return (await part.locate())["readback"]
    (only,) = (await part.read()).values()
    return only["value"]
