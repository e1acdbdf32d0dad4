"""A target that somebody takes out of the beam and puts back by hand."""

from __future__ import annotations

from collections.abc import Callable

from amulor.errors import InstrumentError


class OperatorTargetStage:
    """Asks for what a motor would do.

    Parameters
    ----------
    ask : callable or None
        Shows a text and returns when it has been done; None if nobody is there.
    """

    def __init__(self, ask: Callable[[str], None] | None) -> None:
        self._ask = ask

    def identity(self) -> str:
        """Return that it is an operator."""
        return "operator"

    def bring_in(self, *, timeout: float) -> None:
        """Ask for the target."""
        self._request("The laser is off. Put the target into the beam")

    def take_out(self, *, timeout: float) -> None:
        """Ask for open water."""
        self._request(
            "The laser is off. Take the target out: only water is to be in the beam"
        )

    def make_safe(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""

    def _request(self, text: str) -> None:
        if self._ask is None:
            raise InstrumentError(
                "open-water shots need somebody who moves the target, but this is no "
                "terminal; run it on one, or give target.driver a stage"
            )
        self._ask(text)
