"""Lock-in amplifiers driven by pymeasure, with settings named in the options."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from typing import Any, TypeVar

from amulor.acquisition.plugins import Wiring
from amulor.acquisition.protocols import Overload, Reading
from amulor.errors import InstrumentError, MissingExtraError

_Value = TypeVar("_Value")
#: Required and further entries of the part `options`.
_NEEDED = ("class", "x", "y", "frequency", "time_constant", "full_scale")
_MORE = (
    "prepare", "arguments", "mean", "status", "input_overload", "output_overload",
    "unlocked", "phase", "outputs",
)  # fmt: skip
#: Largest relative difference of the read-back time constant [1].
_SAME = 0.01


class PymeasureLockIn:
    """Lock-in amplifier driven by a class of pymeasure."""

    def __init__(self, wiring: Wiring) -> None:
        options = wiring.options
        missing = [name for name in _NEEDED if name not in options]
        unknown = [name for name in options if name not in (*_NEEDED, *_MORE)]
        if missing or unknown or wiring.address is None:
            raise InstrumentError(
                "a lock-in of pymeasure needs lock_in.address and the options "
                f"{', '.join(_NEEDED)}; missing are {', '.join(missing) or 'none'}, "
                f"not known are {', '.join(unknown) or 'none'}"
            )
        module, _, name = str(options["class"]).partition(":")
        try:
            kind = getattr(importlib.import_module(module), name)
        except ImportError:
            raise MissingExtraError(
                "pymeasure", extra="clients", purpose=f"a lock-in by {options['class']}"
            ) from None
        except AttributeError:
            raise InstrumentError(
                f"{module} has no {name!r}; see lock_in.options.class, such as "
                "pymeasure.instruments.srs:SR860"
            ) from None
        self._options, self._address = options, wiring.address
        self._make = lambda: kind(wiring.address, **options.get("arguments", {}))
        self._instrument: Any = self._checked("answer", self._make)
        self._identity = str(self._checked("identify", self._identify))
        self._outputs = list(options.get("outputs", []))

    def _identify(self) -> str:
        try:
            return str(self._instrument.id)
        except NotImplementedError:  # of instruments that pymeasure counts as non-SCPI
            return str(self._instrument.ask("*IDN?")).strip()

    def identity(self) -> str:
        """Return the identity of the instrument."""
        return self._identity

    def prepare(self, *, time_constant: float) -> None:
        """Set the attributes named in the options, and the time constant [s]."""
        for name, value in self._options.get("prepare", {}).items():
            self._set(name, value)
        self._set(self._options["time_constant"], time_constant)
        actual = float(self._get(self._options["time_constant"]))
        if not math.isclose(actual, time_constant, rel_tol=_SAME):
            raise InstrumentError(
                f"{self._identity} makes {actual:g} s of a time constant of "
                f"{time_constant:g} s; change instrument.lock_in.time_constant"
            )

    def set_frequency(self, frequency: float, *, timeout: float) -> float:
        """Set the modulation frequency [Hz]; return the actual one [Hz]."""
        self._set(self._options["frequency"], frequency)
        self._bits()  # clears earlier status bits
        self._frequency = float(self._get(self._options["frequency"]))
        return self._frequency

    def read(self) -> Reading:
        """Return the present outputs, overload bits and lock state."""
        options = self._options
        if options["x"] == options["y"]:  # a snapshot of both at one moment
            x, y = (float(value) for value in self._get(options["x"])[:2])
        else:
            x, y = float(self._get(options["x"])), float(self._get(options["y"]))
        rises = options.get("phase") == "rises"
        bits, overload = self._bits(), Overload.NONE
        if bits & options.get("input_overload", 0):
            overload |= Overload.INPUT
        if bits & options.get("output_overload", 0):
            overload |= Overload.OUTPUT
        return Reading(
            signal=math.sqrt(2) * complex(x, y if rises else -y),
            mean=float(self._get(options["mean"])) if "mean" in options else math.nan,
            modulation_frequency=self._frequency,
            overload=overload,
            unlocked=bool(bits & options.get("unlocked", 0)),
        )

    def relieve(self, overload: Overload) -> bool:
        """Return False: the scale is fixed in the options."""
        return False

    def sharpen(self, amplitude: float) -> bool:
        """Return False: the scale is fixed in the options."""
        return False

    def full_scale(self) -> float:
        """Return the full scale stated in the options, as a peak amplitude [V]."""
        return math.sqrt(2) * float(self._options["full_scale"])

    def set_output(self, number: int, voltage: float) -> float:
        """Set the voltage of auxiliary output 1, 2, ...; return its read-back [V]."""
        if not 1 <= number <= len(self._outputs):
            raise InstrumentError(
                f"lock_in.options.outputs names {len(self._outputs)} outputs, asked "
                f"for was number {number}; change laser.output"
            )
        self._set(self._outputs[number - 1], voltage)
        return float(self._get(self._outputs[number - 1]))

    def reconnect(self) -> None:
        """Open the link again after it was lost."""
        self.close()
        self._instrument = self._checked("answer", self._make)

    def make_safe(self) -> None:
        """Do nothing: a lock-in is harmless; the laser has its own safe state."""

    def close(self) -> None:
        """Close the link; it may be called twice."""
        adapter = getattr(self._instrument, "adapter", None)
        if adapter is not None:
            adapter.close()

    def _bits(self) -> int:
        return (
            int(self._get(self._options["status"])) if "status" in self._options else 0
        )

    def _get(self, name: str) -> Any:
        value = self._checked(
            f"tell its {name}", lambda: getattr(self._instrument, name)
        )
        return self._checked(f"tell its {name}", value) if callable(value) else value

    def _set(self, name: str, value: Any) -> None:
        if not hasattr(type(self._instrument), name):
            raise InstrumentError(
                f"{self._options['class']} has no attribute {name!r}; see "
                "lock_in.options"
            )
        self._checked(f"set {name}", lambda: setattr(self._instrument, name, value))

    def _checked(self, action: str, call: Callable[[], _Value]) -> _Value:
        try:
            return call()
        except Exception as error:  # pymeasure and its dependencies raise many kinds
            raise InstrumentError(
                f"{self._options['class']} at {self._address} has failed to {action}: "
                f"{type(error).__name__}: {error}; check cable, power, lock_in.options"
            ) from error
