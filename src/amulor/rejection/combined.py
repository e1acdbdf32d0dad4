"""Combined method: open-water subtraction, then unmixing by polarization."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.cube import QualityFlag, tiles
from amulor.rejection import channels, quality, ratios
from amulor.rejection.build import present_terms, saturated_in_any, target_cube
from amulor.rejection.channels import pair_of
from amulor.rejection.covariance import along
from amulor.rejection.methods import Needs, method
from amulor.rejection.observation import Observation
from amulor.rejection.open_water import cube_of, reference_attributes
from amulor.rejection.reference.shots import Noise, with_measured_noise
from amulor.rejection.subtraction import SubtractionFit, subtract_open_water

Floats = NDArray[np.float64]

#: Adds the axis of the one channel of the result.
_WITH_CHANNEL = (slice(None), None)


@dataclass(frozen=True, kw_only=True)
class CombinedFit:
    """Scan-wide parameters of the combined method."""

    noise: Noise
    """Corrections of the stated noise."""
    subtraction: SubtractionFit
    """Scan-wide parameters of the open-water subtraction."""
    target_ratio: ratios.Ratio | None
    """Estimated depolarization ratio of the targets; None if given by the user."""
    terms: tuple[str, ...]
    """Names of the error terms that are not zero everywhere."""
    phase_error_gain: Floats
    """Ratio of target phase error to co-polarized phase error, by frequency [1]."""


def _combine(
    cube: xr.Dataset,
    *,
    interval: tuple[float, float] | None = None,
    target_ratio: float | None = None,
    target_ratio_uncertainty: float = 0.0,
    water_change: float = 0.0,
    column_uncertainty: float | None = None,
    fit: CombinedFit | None = None,
    span: tiles.Span | None = None,
) -> tuple[xr.Dataset, CombinedFit]:
    """Combine the channels of a scan or, with `fit`, of rows; return also the fit."""
    scan = Observation(cube=cubes.checked(cube, "samples"))
    scan, noise = with_measured_noise(scan, None if fit is None else fit.noise)
    cube = scan.cube
    _refuse_odd(target_ratio, water_change)
    co, cross = pair_of(cube)
    subtracted = subtract_open_water(
        scan,
        interval=interval,
        column_uncertainty=column_uncertainty,
        fit=None if fit is None else fit.subtraction,
        span=span,
    )
    estimate = None if fit is None else fit.target_ratio
    if target_ratio is None:
        if estimate is None:
            # The column by the shots alone, whatever is stated for the rest.
            estimate = (
                ratios.ratio_of(cube_of(scan, subtracted)[0])
                if column_uncertainty is None
                else ratios.target_ratio(cube, interval=interval)
            )
        target_ratio = ratios.possible(estimate, name="target_ratio")
        target_ratio_uncertainty = estimate.uncertainty
    else:
        target_ratio_uncertainty = ratios.stated_uncertainty(
            cube, target_ratio, target_ratio_uncertainty
        )
    present = list(cube["polarization"].values)
    channel = [(slice(None), present.index(name)) for name in (co, cross)]
    water = [subtracted.water_signal[index] for index in channel]
    reference = [subtracted.reference.part(index) for index in channel]
    water_ratio = np.divide(
        (water[1] * water[0].conj()).real,
        np.abs(water[0]) ** 2,
        out=np.zeros(water[0].shape),
        where=np.abs(water[0]) > 0,
    )
    # What is wrong with the water is wrong in both channels, in their proportion.
    of_water = subtracted.of_water.part(channel[0])
    solved = channels.unmix(
        [subtracted.target[index] for index in channel],
        [
            subtracted.independent.part(index) + subtracted.reference.part(index)
            for index in channel
        ],
        target_weights=[1.0, target_ratio],
        water_weights=[1.0, water_ratio],
        water_prior=of_water + along(water[0], water_change),
    )
    target = solved.target
    # A wrong ratio moves the crossed channel away from the estimate.
    slope = solved.shift_by([np.zeros_like(target), -target])
    by_ratio = along(slope, target_ratio_uncertainty)
    water_weights: list[Floats | float] = [1.0, water_ratio]
    of_reference = solved.error_of(reference)
    by_water = solved.error_of_water(water_weights, of_water)
    common = of_reference + by_ratio + by_water
    # Added back where the distance is unique; elsewhere the column is unknown.
    residual = None if subtracted.residual is None else subtracted.residual[channel[0]]
    # Errors turn alike, so one of each sum is what the others leave of it.
    column = solved.error_of_water(water_weights, subtracted.column.part(channel[0]))
    counting = solved.error_of([subtracted.counting.part(at) for at in channel])
    rest = counting + of_reference + by_water
    terms = {}
    if water_change > 0:
        by_change = solved.error_of_water(water_weights, along(water[0], water_change))
        terms["water_model"] = by_change
        rest = rest + by_change
    terms |= {
        "counting": counting,
        "fluctuation": solved.independent.without(rest),
        "reference": of_reference,
        "column": column,
        "drift": by_water.without(column),
        "polarization_optics": by_ratio,
    }
    terms = present_terms(terms, None if fit is None else fit.terms)
    tests = dict(subtracted.tests)
    disagreement = tests["channel_disagreement"]
    tests["channel_disagreement"] = np.fmax(*(disagreement[at] for at in channel))[
        :, None
    ]
    first = saturated_in_any(
        cube.sel(polarization=[co]), cube.sel(polarization=[co, cross])
    )
    if fit is not None:
        gain = fit.phase_error_gain
    else:
        parts = np.sqrt(np.sum(solved.gain**2, axis=(0, 2)) / 2)
        gain = quality.phase_error_gain(
            target, list(parts), strongest=target, shown=subtracted.has_target
        )
    result = target_cube(
        first,
        target[:, None],
        (solved.independent + by_ratio).part(_WITH_CHANNEL),
        water_signal=first.amulor.signal.values - target[:, None],
        residual=None if residual is None else residual[:, None],
        common=common.part(_WITH_CHANNEL),
        proportional=(by_ratio + by_water).part(_WITH_CHANNEL),
        terms={name: errors.part(_WITH_CHANNEL) for name, errors in terms.items()},
        tests=tests,
        step=f"reject, combine {co} and {cross} after open water, ratio of the target "
        f"{target_ratio:g}",
        frequencies_share_errors=np.int32(0),
        target_ratio=target_ratio,
        target_ratio_uncertainty=target_ratio_uncertainty,
        **{f"phase_error_gain_{co}": gain, **reference_attributes(subtracted)},
    )
    # The target detection precedes the addition of the column.
    result = quality.add(result, QualityFlag.NO_TARGET, ~subtracted.has_target)
    outlying = subtracted.outlying[channel[0]] | subtracted.outlying[channel[1]]
    result = quality.add(result, QualityFlag.OUTLIER, outlying[:, None])
    if water_change == 0:
        # A doubtful reference cannot be compensated here.
        result = quality.add_water_residual(result, subtracted.cause)
    return result, CombinedFit(
        noise=noise,
        subtraction=subtracted.fit,
        target_ratio=estimate,
        terms=tuple(terms),
        phase_error_gain=gain,
    )


@method(
    "combined",
    needs=Needs(open_water=True, channel_pair=True),
    simplicity=4,
    fitter=partial(tiles.fit_on_sample, _combine),
)
def combined(
    cube: xr.Dataset,
    *,
    interval: tuple[float, float] | None = None,
    target_ratio: float | None = None,
    target_ratio_uncertainty: float = 0.0,
    water_change: float = 0.0,
    column_uncertainty: float | None = None,
) -> xr.Dataset:
    r"""Subtract open water in each channel, then remove residual water by polarization.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with a co-polarized channel, its cross-polarized partner and
        open-water shots.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m].
    target_ratio : float, optional
        Cross-polarized over co-polarized signal of the target, between 0 and 1 [1]; if
        omitted, it is estimated with its uncertainty. An estimate that exceeds 0 or 1
        by less than its error is set to this limit.
    target_ratio_uncertainty : float
        Standard uncertainty of the stated ratio [1].
    water_change : float
        Relative standard deviation by which the water signal at a pixel may differ from
        the reference in both channels alike, beyond its fluctuation from sample to
        sample [1]. A larger value gives polarization more weight.
    column_uncertainty : float, optional
        As in `open_water` [1].

    Returns
    -------
    xarray.Dataset
        Level `target_signal` with one channel, the co-polarized one.

    Raises
    ------
    CubeError
        If one of the channels or the open-water shots are missing. Also if the ratio
        cannot be estimated, or lies outside 0 to 1 by more than its error.
    ValueError
        If the ratio is out of range, or an uncertainty is.

    Notes
    -----
    After subtraction the channels contain :math:`T + \delta` and :math:`r_t T + r_w
    \delta`. The factors r are the depolarization ratios of target and water, the latter
    from the reference; :math:`\delta` is water that the reference lacks. The target
    signal T follows by generalized least squares with the covariance of both channels,
    in which :math:`\delta` is a shared error. With :math:`\delta = 0` the result is the
    weighted mean of the channels; for a large one it is unmixing.
    """
    return _combine(
        cube,
        interval=interval,
        target_ratio=target_ratio,
        target_ratio_uncertainty=target_ratio_uncertainty,
        water_change=water_change,
        column_uncertainty=column_uncertainty,
    )[0]


def _refuse_odd(target_ratio: float | None, water_change: float) -> None:
    if target_ratio is not None and not 0 <= target_ratio <= 1:
        raise ValueError(f"target_ratio must lie between 0 and 1, got {target_ratio:g}")
    if not 0 <= water_change < np.inf:
        raise ValueError(
            f"water_change must be finite and not negative, got {water_change:g}"
        )
