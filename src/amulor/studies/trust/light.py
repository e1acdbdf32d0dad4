"""Scans that follow the form of the paper, which the joint estimation fits."""

from __future__ import annotations

import numpy as np
import xarray as xr

from amulor import simulation
from amulor.simulation import DiffusionModel
from amulor.survey import Survey

__all__ = ["simulate"]


def simulate(survey: Survey, *, rng: np.random.Generator | int) -> xr.Dataset:
    """Simulate a scan by the diffusion form (46) of Ricci et al. 2010.

    Parameters
    ----------
    survey : Survey
        What is measured.
    rng : numpy.random.Generator or int
        Source of the noise, or a seed.

    Returns
    -------
    xarray.Dataset
        As of `amulor.simulate`; scenes of other models name theirs.
    """
    return simulation.simulate(survey, rng=rng, model=DiffusionModel())
