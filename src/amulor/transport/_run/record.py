"""The record of path lengths of one batch, around the compiled deposits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor.transport._kernels import record as _record_kernels
from amulor.transport._kernels.types import Record as Deposits
from amulor.transport._run.batches import Batch
from amulor.transport.tally import Tally

#: Fewest and most nodes of a record.
_FEWEST_NODES, _MOST_NODES = 512, 16384
#: Step of the record at the highest frequency [rad], and in attenuation lengths.
_STEP = 0.05

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


def random_state(seed: int, number: int) -> NDArray[np.uint64]:
    """Return the state of the random numbers of a batch."""
    sequence = np.random.SeedSequence(seed, spawn_key=(number,))
    return sequence.generate_state(4, np.uint64).astype(np.uint64)


@dataclass(frozen=True, eq=False, kw_only=True)
class Record:
    """Arrays that a batch fills, and what is read from them."""

    mass: Array
    edge: Array
    beyond: Complex
    wavenumber: Complex
    spacing: float

    @classmethod
    def empty(
        cls, attenuation: Array, group_index: float, frequency: Array, frame: Tally
    ) -> Self:
        """Return a record without light, for the parts of a tally."""
        wavenumber = 2j * np.pi * frequency * group_index / speed_of_light
        steepest = max(float(np.abs(wavenumber).max()), float(attenuation.max()))
        spacing = _STEP / steepest
        wanted = 30 / float(attenuation[attenuation > 0].min()) / spacing
        nodes = int(min(max(wanted, _FEWEST_NODES), _MOST_NODES))
        shape = (len(frame.parts), frame.batches.shape[2])
        return cls(
            mass=np.zeros((*shape, nodes)),
            edge=np.zeros((*shape, nodes)),
            beyond=np.zeros((*shape, frequency.size), dtype=np.complex128),
            wavenumber=wavenumber,
            spacing=spacing,
        )

    def arrays(self, orders: int) -> Deposits:
        """Return what the kernels take, with that many parts for orders."""
        return Deposits(
            mass=self.mass,
            edge=self.edge,
            beyond=self.beyond,
            wavenumber=self.wavenumber,
            spacing=self.spacing,
            orders=orders,
        )

    def batch(
        self, number: int, histories: int, units: int, weight: Array, *, keep: bool
    ) -> Batch:
        """Return the batch, as means over units of work."""
        _record_kernels.transform(
            self.mass, self.edge, self.wavenumber, self.spacing, self.beyond
        )
        return Batch(
            number=number,
            histories=histories,
            signal=self.beyond / units,
            weight=weight,
            mass=self.mass / units if keep else None,
            edge=self.edge / units if keep else None,
            spacing=self.spacing,
        )
