"""What the lock-in amplifiers of Stanford Research have in common."""

from __future__ import annotations

import math
from collections.abc import Sequence

from amulor.acquisition.clock import Clock
from amulor.acquisition.links.visa import Conversation
from amulor.errors import InstrumentError

#: Bits of the standard event register: execution error and command error.
_ERROR_BITS = 0b0011_0000


class Stanford:
    """A conversation with a Stanford lock-in, from identity to auxiliary outputs.

    Parameters
    ----------
    link : Conversation
        An open link.
    mean_output_input : int or None
        Auxiliary input that the mean output of the detector is wired to [1].
    clock : Clock
        What waits go by.
    external : bool
        Whether the frequency comes from a generator at the reference input.
    """

    model = ""
    #: What a line ends with on a serial port.
    serial_end = "\n"
    #: How many auxiliary inputs there are.
    _inputs = 0
    #: Number of the first auxiliary output in commands, and how many there are.
    _first_output, _outputs = 1, 0
    _set_output = ""
    #: What an auxiliary input is asked by, and its first number.
    _get_input, _first_input = "", 1

    def __init__(
        self,
        link: Conversation,
        *,
        mean_output_input: int | None,
        clock: Clock,
        external: bool = False,
    ) -> None:
        if mean_output_input is not None and not 1 <= mean_output_input <= self._inputs:
            raise InstrumentError(
                f"{self.model} has auxiliary inputs 1 to {self._inputs}, stated is "
                f"{mean_output_input}; wire another one, and change "
                "lock_in.mean_output_input"
            )
        self._link = link
        self._clock = clock
        self._mean_input = mean_output_input
        self._external = external
        self._choose_interface()
        self._identity = self._identify()

    def identity(self) -> str:
        """Return maker, model, serial number and firmware."""
        return self._identity

    def set_output(self, number: int, voltage: float) -> float:
        """Set an auxiliary output, counted from 1 as on the panel [V]; read it back.

        Parameters
        ----------
        number : int
            Which one [1].
        voltage : float
            What it is set to [V].

        Returns
        -------
        float
            What the instrument says that it stands at [V].

        Raises
        ------
        InstrumentError
            If there is no such output, or the answer is none.
        """
        if not 1 <= number <= self._outputs:
            raise InstrumentError(
                f"{self.model} has auxiliary outputs 1 to {self._outputs}, asked for "
                f"was {number}; wire another one, and change laser.output"
            )
        word, code = self._set_output, number - 1 + self._first_output
        return self.number(f"{word} {code},{voltage:.3f};{word}? {code}")

    def input(self, number: int) -> float:
        """Return the voltage at an auxiliary input, counted from 1 as on the panel [V].

        Raises
        ------
        InstrumentError
            If there is no such input, or the answer is none.
        """
        if not 1 <= number <= self._inputs:
            raise InstrumentError(
                f"{self.model} has auxiliary inputs 1 to {self._inputs}, asked for was "
                f"{number}; wire another one, and change laser.interlock_input"
            )
        return self.number(f"{self._get_input}? {number - 1 + self._first_input}")

    def reconnect(self) -> None:
        """Open the link again after it was lost."""
        self._link.reopen()
        self._choose_interface()

    def make_safe(self) -> None:
        """Do nothing: a lock-in without light is safe; the laser's gate is its own."""

    def close(self) -> None:
        """Close the link."""
        self._link.close()

    def number(self, line: str) -> float:
        """Return the number that a query is answered with."""
        return self.numbers(line, count=1)[0]

    def numbers(self, line: str, *, count: int) -> list[float]:
        """Return the numbers, separated by commas, that a query is answered with."""
        (answer,) = self._link.ask(line)
        return self.parsed(answer, line, count=count)

    def parsed(self, answer: str, line: str, *, count: int) -> list[float]:
        """Return the numbers of an answer, or say what is wrong with it."""
        try:
            result = [float(part) for part in answer.split(",")]
        except ValueError:
            result = []
        if len(result) != count or not all(map(math.isfinite, result)):
            raise InstrumentError(
                f"{self.model} at {self._link.address} has answered {line!r} by "
                f"{answer!r}, needed are {count} numbers; switch it off and on"
            )
        return result

    def configure(self, lines: Sequence[str]) -> None:
        """Send settings and make sure that the instrument took all of them."""
        for line in lines:
            self._link.send(line)
        status = int(self.number("*ESR?"))
        if status & _ERROR_BITS:
            raise InstrumentError(
                f"{self.model} at {self._link.address} refused one of "
                f"{'; '.join(lines)} (event status {status}); check its firmware"
            )

    def index_of(
        self, wanted: float, offered: Sequence[float], what: str, unit: str = "s"
    ) -> int:
        """Return the code of a value that the instrument offers."""
        for code, value in enumerate(offered):
            if math.isclose(value, wanted, rel_tol=1e-6):
                return code
        closest = sorted(offered, key=lambda value: abs(math.log(value / wanted)))[:2]
        raise InstrumentError(
            f"{self.model} has no {what} of {wanted:g} {unit}; it has "
            f"{min(closest):g} {unit} and {max(closest):g} {unit}: change "
            f"{'instrument.lock_in of the survey' if unit == 's' else 'the setting'}"
        )

    def _choose_interface(self) -> None:
        """Let answers come over this link, if the instrument must be told."""

    def _identify(self) -> str:
        (result,) = self._link.ask("*IDN?")
        parts = [part.strip() for part in result.split(",")]
        if len(parts) < 2 or parts[1] != self.model:
            raise InstrumentError(
                f"at {self._link.address} is {result!r}, needed is {self.model}; check "
                "the address"
            )
        return result
