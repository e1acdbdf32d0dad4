"""Estimates target and water together from samples at several frequencies."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from amulor import cube as cubes
from amulor.cube import tiles
from amulor.rejection.joint.instrument import (
    DIRECTION,
    LATE_ECHO,
    Instrument,
)
from amulor.rejection.joint.samples import refuse_what_cannot_be_told_apart
from amulor.rejection.joint.tile import Common, common_of, of_rows
from amulor.rejection.methods import method

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


def _fit(source: tiles.Source, **options: Any) -> tiles.OfRows:
    """Estimate what all pixels share, for any rows of a scan."""
    common = prepared(source, **options)
    return lambda rows, first: of_rows(rows, common, first)


@method("joint", simplicity=5, distrusts_open_water=True, fitter=_fit)
def joint(
    cube: xr.Dataset,
    *,
    interval: tuple[float, float] | None = None,
    echo_transfer: NDArray[np.complex128] | None = None,
    delay_uncertainty: float = 0.0,
    group_index_uncertainty: float = 0.0,
    receiver_position_uncertainty: float = 0.0,
    receiver_direction_uncertainty: float = DIRECTION,
    late_echo_uncertainty: float | None = None,
) -> xr.Dataset:
    r"""Estimate target and water signal together, by maximum likelihood.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples` with at least two modulation frequencies and the attribute
        `survey`, of which the instrument, the scan and the shape of the water's phase
        function are used; how much it scatters and absorbs, and how far, is not.
        Open-water shots are used if there are any.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m]. From 0 to the
        unambiguous range of the frequencies by default.
    echo_transfer : ndarray of complex, optional
        What the echo of the target has beyond its delay at each frequency, such as
        the spread of its arrival times, if it is known [1]; 1 by default.
    delay_uncertainty : float, optional
        Standard uncertainty of the delay of the instrument, which all channels share
        [s]. By default this and the next two are not counted here: a range image counts
        what the survey's `[calibration]` states, and says what nobody states.
    group_index_uncertainty : float, optional
        Standard uncertainty of the group index of the water [1].
    receiver_position_uncertainty : float, optional
        Standard uncertainty of the receiver's place to the right and down [m]. Where it
        stands forward of the emitter is part of the delay.
    receiver_direction_uncertainty : float, optional
        Standard uncertainty of the axis of the receiver in azimuth and elevation
        [rad]; 1 degree by default.
    late_echo_uncertainty : float, optional
        Standard uncertainty of how late the echo is by scattering on its way, over
        twice what `optics.late_echo` says for the estimated spread of the light [1]. By
        default 0.5, and 0 for a simulation without late light; 0 is right where
        `echo_transfer` holds it, or the range of the echo is asked for.

    Returns
    -------
    xarray.Dataset
        Level `target_signal`: the samples less the water signal that ends at the
        target. Variables that begin with `joint_` hold, over (row, column), the
        `slant_range` [m], its `slant_range_uncertainty`, the part of it that all pixels
        share (`slant_range_common_uncertainty`), the Cramer-Rao `slant_range_bound`,
        `slant_range_lower` and `slant_range_upper` ends of the 68 % interval from the
        profile of the likelihood, the `wrong_interval_probability`, the `misfit`
        (chi-square over its degrees of freedom), and the slant ranges of both surfaces
        where there are two, `nearer_surface` and `farther_surface` [m].
        Attributes that begin with `joint_` hold what the pixels share.

    Raises
    ------
    CubeError
        If the cube has a single frequency, no survey, errors that are zero, a
        receiver that does not see the beam, or a scan that moves towards a window.
    ValueError
        If the interval is empty or holds far too many ambiguity intervals, or the
        transfer is not one number above zero for each frequency.

    Notes
    -----
    In channel c and at frequency f a pixel shows
    :math:`A_c H(f) e^{2 \pi i f p / c_0} + s_c W(f; k', b_f \langle\theta^2\rangle,
    z)`, with the optical path p and the depth z of the target, and W the water signal
    (29) of [1]_, as rebuilt, that ends there, by the phase function of the survey's
    water, stretched in angle; (46) where that water has none. Strengths and shape of W
    belong to the whole scan. A smooth factor on its overlap, light from in front of all
    targets and departures of the echo at each frequency, with priors whose widths the
    data choose, stand for what the model does not know; their uncertainty is part of
    that of the result. A random change of the water signal from sample to sample is
    estimated from the scatter. Light that is scattered on its way to the target arrives
    late; what `echo_transfer` does not hold of that is in the slant range, and in its
    uncertainty.

    Open-water shots may be of other water: their strength and, at each frequency, a
    departure from the water of the scan have priors whose widths the data choose.
    What the samples cannot tell widens the intervals: delay, group index, place of
    the receiver and late echoes move all ranges together
    (`slant_range_common_uncertainty`). The direction of the receiver is estimated with
    its prior, and the scale of the stated noise from differences between neighbouring
    pixels; see decision 11. The strength of the water may change smoothly with the time
    of the pixels.

    Samples that disagree with the rest of their pixel are left out, a third of them at
    most, and flagged `OUTLIER`; so is the whole pixel where it stays open which samples
    are wrong. `MIXED`: two surfaces explain a pixel and one does not, from three
    frequencies on; see decision 14.

    Flags: `NO_TARGET` where open water explains the samples about as well;
    `AMBIGUOUS` where another interval is likelier than 3e-4; `WATER_RESIDUAL` where
    the samples contradict the model (chi-square beyond chance 1e-4) or the departures
    that the scan shows move the path by ten times its other uncertainty, 0.3 of it if
    the echo alone departs. What they move it by is part of the uncertainty.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.
    """
    cube = cubes.checked(cube, "samples")
    common = prepared(
        tiles.InMemory(cube),
        interval=interval,
        echo_transfer=echo_transfer,
        delay_uncertainty=delay_uncertainty,
        group_index_uncertainty=group_index_uncertainty,
        receiver_position_uncertainty=receiver_position_uncertainty,
        receiver_direction_uncertainty=receiver_direction_uncertainty,
        late_echo_uncertainty=late_echo_uncertainty,
    )
    return of_rows(cube, common)


def prepared(
    source: tiles.Source,
    *,
    interval: tuple[float, float] | None = None,
    echo_transfer: NDArray[np.complex128] | None = None,
    delay_uncertainty: float = 0.0,
    group_index_uncertainty: float = 0.0,
    receiver_position_uncertainty: float = 0.0,
    receiver_direction_uncertainty: float = DIRECTION,
    late_echo_uncertainty: float | None = None,
) -> Common:
    """Return what all pixels share, for the joint estimation of any rows of a scan.

    Parameters
    ----------
    source : Source
        Level `samples`, checked; in memory, or a file.
    interval, echo_transfer, delay_uncertainty, group_index_uncertainty
        As in `joint`.
    receiver_position_uncertainty, receiver_direction_uncertainty
        As in `joint`.
    late_echo_uncertainty
        As in `joint`.

    Returns
    -------
    Common
        From 1,024 pixels that are spread over the scan, or all of a smaller one, and
        as many shots.

    Raises
    ------
    CubeError, ValueError
        As `joint`.
    """
    head = source.head
    refuse_what_cannot_be_told_apart(head)
    frequency = head["modulation_frequency"].values
    instrument = Instrument.checked(
        delay=delay_uncertainty,
        group_index=group_index_uncertainty,
        position=receiver_position_uncertainty,
        direction=receiver_direction_uncertainty,
        late_echo=_late_echo(head)
        if late_echo_uncertainty is None
        else late_echo_uncertainty,
    )
    # Hundreds of small matrices: threads of BLAS wait for each other longer than they
    # work, ten times longer where other programs have the processors.
    with threadpool_limits(limits=1, user_api="blas"):
        return common_of(
            source,
            interval=interval,
            transfer=_checked_transfer(echo_transfer, frequency),
            instrument=instrument,
        )


def _checked_transfer(
    transfer: NDArray[np.complex128] | None, frequency: Floats
) -> Complex:
    if transfer is None:
        return np.ones(frequency.size, dtype=complex)
    given = np.asarray(transfer, dtype=complex)
    if given.shape != frequency.shape or not np.all(
        np.isfinite(given) & (np.abs(given) > 0)
    ):
        raise ValueError(
            f"echo_transfer must be one finite number other than 0 for each of the "
            f"{frequency.size} modulation frequencies, got shape {given.shape}"
        )
    return given


def _late_echo(cube: xr.Dataset) -> float:
    """Return how uncertain the delay of scattered light is, over its theory."""
    stated = cube.attrs.get("late_echo")
    if stated is None:
        # Models that say nothing of late light send none.
        return 0.0 if cube.attrs.get("simulated", 0) else LATE_ECHO
    return 0.0 if str(stated) == "absent" else LATE_ECHO
