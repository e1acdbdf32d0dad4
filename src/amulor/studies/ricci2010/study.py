"""Study object: input numbers, and cached results common to all figures."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np

from amulor.studies.ricci2010.parameters import Parameter, load

Result = TypeVar("Result")


class Study:
    """Input numbers of the study, with a cache of results computed from them.

    `study["name"]` gives a number and notes that it was read. `study.once(function)`
    gives `function(study)`, computed again only if a number has changed that the
    function read; so figures share what they have in common, and the sensitivity study
    repeats no more than it must.
    """

    def __init__(
        self,
        parameters: Mapping[str, Parameter] | None = None,
        *,
        quick: bool = False,
        rng: int = 1,
    ) -> None:
        self.parameters = dict(load() if parameters is None else parameters)
        self.quick = quick
        self.seed = int(rng)
        self._read: list[set[str]] = []
        self._known: dict[Any, list[tuple[dict[str, float], Any]]] = {}

    def __getitem__(self, name: str) -> float:
        """Return an input number in the unit of `amulor.units.SI_UNITS`."""
        for names in self._read:
            names.add(name)
        return self.parameters[name].value

    def with_parameters(self, parameters: Mapping[str, Parameter]) -> Study:
        """Return a study with other input numbers and a shared cache."""
        changed = Study(parameters, quick=self.quick, rng=self.seed)
        changed._known = self._known
        return changed

    def rng(self, label: str) -> np.random.Generator:
        """Return the random number generator for one series of synthetic noise."""
        return np.random.default_rng([self.seed, zlib.crc32(label.encode())])

    def once(self, function: Callable[[Study], Result]) -> Result:
        """Return the result of a function of the study, from the cache if present."""
        for numbers, result in self._known.setdefault(function, []):
            if all(self.parameters[n].value == v for n, v in numbers.items()):
                for names in self._read:
                    names.update(numbers)
                outcome: Result = result
                return outcome
        names, outcome = self.read_by(function)
        self._known[function].append((self._values(names), outcome))
        return outcome

    def read_by(self, function: Callable[[Study], Result]) -> tuple[set[str], Result]:
        """Evaluate a function; return the input numbers it used, and the result."""
        names: set[str] = set()
        self._read.append(names)
        try:
            result = function(self)
        finally:
            self._read.pop()
        return names, result

    def _values(self, names: set[str]) -> dict[str, float]:
        return {name: self.parameters[name].value for name in names}
