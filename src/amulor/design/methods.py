"""The rejection methods whose error a design predicts, each with what it depends on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from amulor.design._kernels import points as kernel

__all__ = ["PREDICTED", "Method", "Predicted"]

Method = Literal["none", "frequency", "open-water", "polarization", "combined", "joint"]


@dataclass(frozen=True, kw_only=True)
class Predicted:
    """Prediction of the error of one rejection method."""

    kernel: int
    """Number of the method in the compiled loop."""
    channel_pair: bool = False
    """Whether it needs a co-polarized channel and its partner."""
    separate_frequencies: bool = True
    """Whether each frequency has a phase of its own."""
    assumptions: tuple[str, ...] = ()
    """Fields of a goal's assumptions on which the error depends."""


#: By the names of `amulor.rejection.names`.
PREDICTED: dict[str, Predicted] = {
    "none": Predicted(kernel=kernel.KEPT),
    "frequency": Predicted(kernel=kernel.ONE_FREQUENCY, separate_frequencies=False),
    "open-water": Predicted(
        kernel=kernel.OPEN_WATER,
        assumptions=("water_change", "column_uncertainty"),
    ),
    "polarization": Predicted(
        kernel=kernel.UNMIX, channel_pair=True, assumptions=("ratio_uncertainty",)
    ),
    "combined": Predicted(
        kernel=kernel.COMBINED,
        channel_pair=True,
        assumptions=("water_change", "column_uncertainty", "ratio_uncertainty"),
    ),
    "joint": Predicted(
        kernel=kernel.JOINT,
        separate_frequencies=False,
        assumptions=("departure",),
    ),
}
