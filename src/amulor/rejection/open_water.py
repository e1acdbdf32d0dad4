"""Open-water method: subtraction of the water signal measured without a target."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from amulor import cube as cubes
from amulor.cube import QualityFlag, tiles
from amulor.cube.error import FREQUENCY_PHASES, FREQUENCY_PROBABILITY
from amulor.rejection import quality
from amulor.rejection.build import present_terms, target_cube
from amulor.rejection.methods import Needs, method
from amulor.rejection.observation import Observation
from amulor.rejection.quality import ChannelPhase
from amulor.rejection.reference.shots import Noise, with_measured_noise
from amulor.rejection.subtraction import (
    Subtraction,
    SubtractionFit,
    subtract_open_water,
)


@dataclass(frozen=True, kw_only=True)
class OpenWaterFit:
    """Scan-wide parameters of the open-water method."""

    noise: Noise
    """Corrections of the stated noise."""
    subtraction: SubtractionFit
    """Scan-wide parameters of the open-water subtraction."""
    terms: tuple[str, ...]
    """Names of the error terms that are not zero everywhere."""


def subtract(
    cube: xr.Dataset,
    *,
    fit: OpenWaterFit | None = None,
    span: tiles.Span | None = None,
    **options: Any,
) -> tuple[xr.Dataset, OpenWaterFit]:
    """Subtract open water from a scan, or with `fit` from rows; return also the fit."""
    scan = Observation(cube=cubes.checked(cube, "samples"))
    scan, noise = with_measured_noise(scan, None if fit is None else fit.noise)
    subtracted = subtract_open_water(
        scan, fit=None if fit is None else fit.subtraction, span=span, **options
    )
    result, terms = cube_of(scan, subtracted, terms=None if fit is None else fit.terms)
    return result, OpenWaterFit(noise=noise, subtraction=subtracted.fit, terms=terms)


@method(
    "open-water",
    needs=Needs(open_water=True),
    simplicity=1,
    fitter=partial(tiles.fit_on_sample, subtract),
)
def open_water(
    cube: xr.Dataset,
    *,
    interval: tuple[float, float] | None = None,
    column_uncertainty: float | None = None,
    put_back: bool = True,
) -> xr.Dataset:
    r"""Subtract the open-water signal from samples, phasor by phasor.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with open-water shots at the same frequencies and channels, in
        the order of their recording. Their directions may be sparse, but must reach
        the edges of the scan.
    interval : tuple of float, optional
        Nearest and farthest possible slant range [m], which determines the water behind
        the target. From 0 to the unambiguous range by default.
    column_uncertainty : float, optional
        Relative standard uncertainty of the survey's water behind the target, such as
        0.2 [1]. By default the shots correct the survey's turbidity, and the
        uncertainty of this correction is used.
    put_back : bool
        Whether to add the water behind the target again, which the shots contain and
        the samples do not. If False, it is only estimated, in the `residual_`
        variables.

    Returns
    -------
    xarray.Dataset
        Level `target_signal`, with these variables and attributes:

        - `in_phase_uncertainty`, `quadrature_uncertainty`: noise of the instrument,
          fluctuation of the water among the shots, error of the reference between
          the shots, and drift from the first shot to the last.
        - `common_` variables: the part of these errors that pixels share.
        - `residual_` variables: estimate of the residual water signal, since the
          target ends the water column (zero with `put_back`); only if the cube's
          survey describes the water.
        - `open_water_drift`, `open_water_drift_uncertainty`: relative change of the
          reference, for each frequency. The uncertainty is infinite if no direction
          was repeated or no drift is stated.
        - `open_water_change`, `open_water_change_uncertainty`: relative difference
          of the water of the scan from the reference, estimated from the phases of
          the scan. The signal is corrected for it.
        - `channel_phase_probability`: probability of so large a phase between
          channels of the target by chance. Below 1e-4 `channel_phase_rad` is the
          phase for each frequency. It counts as an error of the range.

    Raises
    ------
    CubeError
        If there are no open-water shots, too few to judge their scatter, if the
        scan goes beyond their directions, or the water changed by more than a fifth
        between the first and the last.
    ValueError
        If the interval is empty or contains far too many ambiguity intervals, or the
        uncertainty of the column is not between 0 and 1.

    Notes
    -----
    Eqs. (55)-(58) of [1]_, computed as a difference of phasors, which needs no choice
    of a quadrant. A significant drift (1 of 1000 by chance) is an error with a
    rectangular distribution of its size. Phases that disagree reveal water that is
    stronger than its reference. Flags:

    - `NO_TARGET`: no significant echo, decided before the water behind the target is
      added again.
    - `OUTLIER`: the channels disagree in distance. A range image discards the sample
      if two thirds of the frequencies remain.
    - `WATER_RESIDUAL` of a pixel: with two frequencies or channels, a residual has
      the shape of the water signal. At a single frequency, the water behind the
      target is stronger than 0.3 (30 %) of the target.
    - `WATER_RESIDUAL` of all pixels: the water changed by more than 30 %, no water
      explains the shots (departure beyond 20 %), or the channels of the target differ
      in phase by more than 0.05 rad. `water_residual_cause` names the reason.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    How much of the water is left, of what was there: the cube knows the true target.

    >>> import numpy as np
    >>> from amulor import rejection, samples
    >>> cube = samples.cube("ladder").isel(row=[18], shot=slice(0, None, 4))
    >>> target = rejection.open_water(cube).amulor.signal.values
    >>> truth = cube["truth_target_in_phase"] + 1j * cube["truth_target_quadrature"]
    >>> water = cube["truth_water_in_phase"] + 1j * cube["truth_water_quadrature"]
    >>> residual = np.abs((target - truth.values).mean())
    >>> print(f"{100 * residual / np.abs(water.values.mean()):.1f} % of the water left")
    0.6 % of the water left
    """
    return subtract(
        cube,
        interval=interval,
        column_uncertainty=column_uncertainty,
        put_back=put_back,
    )[0]


def cube_of(
    scan: Observation, subtracted: Subtraction, *, terms: tuple[str, ...] | None = None
) -> tuple[xr.Dataset, tuple[str, ...]]:
    """Return the target-signal cube of a subtraction, and its error-term names."""
    present = present_terms(
        {
            "counting": subtracted.counting,
            "fluctuation": subtracted.fluctuation,
            "reference": subtracted.reference,
            "column": subtracted.column,
            "drift": subtracted.change,
        },
        terms,
    )
    result = target_cube(
        scan.cube,
        subtracted.target,
        subtracted.independent + subtracted.shared,
        water_signal=subtracted.water_signal,
        residual=subtracted.residual,
        common=subtracted.shared,
        proportional=subtracted.of_water,
        terms=present,
        tests=subtracted.tests,
        step="reject, open water"
        + (", column behind the target put back" if subtracted.put_back else ""),
        frequencies_share_errors=np.int32(0),
        **{
            f"phase_error_gain_{name}": gain
            for name, gain in zip(
                scan.polarizations,
                subtracted.fit.phase_error_gain.T,
                strict=True,
            )
        },
        **reference_attributes(subtracted),
    )
    result = quality.add_water_residual(result, subtracted.cause)
    result = quality.add(result, QualityFlag.OUTLIER, subtracted.outlying)
    return quality.add(result, QualityFlag.NO_TARGET, ~subtracted.has_target), tuple(
        present
    )


def reference_attributes(subtracted: Subtraction) -> dict[str, Any]:
    """Return polynomial degree, drift, change and turbidity of the water signal."""
    fits, turbidity = subtracted.water.fits, subtracted.water.turbidity
    attributes = {
        "open_water_degree": np.array([fit.degree for fit in fits], dtype=np.int32),
        "open_water_drift": np.array([abs(fit.drift.change) for fit in fits]),
        "open_water_drift_uncertainty": np.array(
            [abs(fit.drift.uncertainty) for fit in fits]
        ),
        "open_water_change": subtracted.fit.strength.change,
        "open_water_change_uncertainty": subtracted.fit.strength.uncertainty,
        **channel_phase_attributes(subtracted.fit.channel_phase),
    }
    phases = subtracted.fit.strength.phases
    if phases is not None:
        attributes[FREQUENCY_PROBABILITY] = phases.probability
        attributes[FREQUENCY_PHASES] = phases.phase
    if subtracted.fit.disagreement:
        limits = [pair.limit for pair in subtracted.fit.disagreement]
        # netCDF gives an array of one number back as a number.
        attributes["channel_disagreement_limit"] = (
            np.array(limits) if len(limits) > 1 else limits[0]
        )
    if turbidity is None:
        return attributes
    return attributes | {
        "open_water_turbidity": turbidity.factor,
        "open_water_turbidity_uncertainty": turbidity.factor * turbidity.uncertainty,
        "open_water_misfit": turbidity.misfit,
    }


def channel_phase_attributes(channel_phase: ChannelPhase | None) -> dict[str, Any]:
    """Return the channels' phase difference and its probability, as attributes."""
    if channel_phase is None:
        return {}
    attributes: dict[str, Any] = {
        "channel_phase_probability": channel_phase.probability
    }
    if channel_phase.is_real:
        attributes["channel_phase_rad"] = channel_phase.phase
    return attributes
