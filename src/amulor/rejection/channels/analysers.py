"""Unmixes target and water from any analyser states, in the form of Stokes vectors."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from amulor import cube as cubes
from amulor.errors import CubeError
from amulor.optics.polarization import mueller, stokes
from amulor.rejection.build import present_terms, saturated_in_any, target_cube
from amulor.rejection.channels import mixing
from amulor.rejection.covariance import Covariance, covariance_of
from amulor.rejection.reference.noise import with_noise_of_shots
from amulor.rejection.reference.shots import fit_shots, fluctuation_of
from amulor.rejection.reference.size import not_smaller_than_shots_say

Floats = NDArray[np.float64]

#: Analyser states tell the Stokes vector if their matrix is no worse than that [1].
_WORST_CONDITION = 100.0
#: Target and water differ if their Stokes vectors span an angle of that sine [1].
_SMALLEST_ANGLE = 1e-3


def stokes_vectors(cube: xr.Dataset, *, launched: str) -> xr.DataArray:
    r"""Return the Stokes vector of the modulated light of every sample.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples` or `target_signal`, with at least four analyser states that
        tell a Stokes vector, such as V, H, P and R.
    launched : str
        State that was launched: the first letter of the channels to take.

    Returns
    -------
    xarray.DataArray
        Complex, dimensions (stokes, modulation_frequency, row, column), the first
        component the signal without an analyser [V].

    Raises
    ------
    CubeError
        If the analyser states do not tell a Stokes vector.

    Notes
    -----
    Each component of (59) of Ricci et al. 2010, as rebuilt, is a power and so has a
    modulation of its own, amplitude and phase. An ideal analyser with the Stokes
    vector a passes :math:`\\tfrac12 \\mathbf a \\cdot \\mathbf S`; least squares.

    Examples
    --------
    Two more analyser states that pass half of the light each: neither diagonal nor
    circular polarization is found.

    >>> import numpy as np
    >>> import xarray as xr
    >>> from amulor import cube as cubes, rejection, samples
    >>> pair = cubes.without_groups(samples.cube("ladder").isel(row=[20]))
    >>> half = pair.mean("polarization", keep_attrs=True)
    >>> more = [half.expand_dims(polarization=[name]) for name in ("VP", "VR")]
    >>> four = xr.concat([pair, *more], "polarization", data_vars="minimal")
    >>> stokes = rejection.stokes_vectors(four, launched="V")
    >>> bool(np.allclose(stokes[2:], 0, atol=1e-12))
    True
    """
    cube = cubes.checked(cube)
    chosen = _launched_as(cube, launched)
    matrix = np.array([stokes.state(name[1]) / 2 for name in chosen])
    if len(chosen) < 4 or np.linalg.cond(matrix) > _WORST_CONDITION:
        raise CubeError(
            f"the channels {', '.join(chosen)} do not tell a Stokes vector; needed are "
            f"four analyser states with {launched} launched, such as "
            f"{', '.join(launched + letter for letter in 'VHPR')}"
        )
    signal = cube.sel(polarization=chosen).amulor.signal.values
    vectors = np.einsum("sc,fcij->sfij", np.linalg.pinv(matrix), signal)
    return xr.DataArray(
        vectors,
        dims=("stokes", "modulation_frequency", "row", "column"),
        coords={
            "stokes": list("IQUV"),
            "modulation_frequency": cube["modulation_frequency"].values,
        },
        attrs={"units": "V", "long_name": "Stokes vector of the modulated light"},
    )


def unmix_stokes(
    cube: xr.Dataset,
    *,
    launched: str,
    target_mueller: ArrayLike,
    water_mueller: ArrayLike,
) -> xr.Dataset:
    r"""Separate target and water by their Mueller matrices, from all analyser states.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with two analyser states or more of one launched state.
    launched : str
        State that was launched: the first letter of the channels to take.
    target_mueller, water_mueller : array_like, shape (4, 4)
        Reduced Mueller matrices straight backwards [1].

    Returns
    -------
    xarray.Dataset
        Level `target_signal` with one channel, the first one, in which the target
        signal is given.

    Raises
    ------
    CubeError
        If there are fewer than two analyser states, or both matrices make the same
        light of what is launched.
    ValueError
        If a matrix is not (4, 4).

    Notes
    -----
    Generalised least squares of :math:`y_c = t_c T + w_c W` with the fractions t and w
    that the analysers pass, (60) and (69) of Ricci et al. 2010, as rebuilt; with four
    states it is the fit of the Stokes vector by those of target and water. The
    fluctuation of the water is taken from the open-water shots, if there are any.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor import rejection, samples
    >>> target = rejection.unmix_stokes(
    ...     samples.cube("ladder").isel(row=[18]),
    ...     launched="V",
    ...     target_mueller=np.diag([1, 0.61, -0.61, -0.46]),
    ...     water_mueller=np.diag([1, 0.82, -0.82, -0.64]),
    ... )
    >>> target.amulor.polarizations
    ['VV']
    """
    cube, _ = with_noise_of_shots(cubes.checked(cube, "samples"))
    chosen = _launched_as(cube, launched)
    if len(chosen) < 2:
        raise CubeError(
            f"the cube has the channels {', '.join(cube.amulor.polarizations)}; "
            f"unmixing needs two or more with {launched} launched"
        )
    fractions = [
        np.array([float(mueller.detected_fraction(matrix, pair=c)) for c in chosen])
        for matrix in (target_mueller, water_mueller)
    ]
    lengths = np.linalg.norm(fractions, axis=1)
    across = lengths[0] * lengths[1] - abs(fractions[0] @ fractions[1])
    smallest = _SMALLEST_ANGLE**2 / 2 * lengths[0] * lengths[1]
    if fractions[0][0] <= 0 or across < smallest:
        raise CubeError(
            f"target and water pass the analysers {', '.join(chosen)} in the same "
            "proportions, or the first one shows no target; other channels or other "
            "Mueller matrices are needed to tell them apart"
        )
    # In units of what the first channel sees of the target.
    weights = [list(seen / fractions[0][0]) for seen in fractions]
    part = cube.sel(polarization=chosen)
    signal = part.amulor.signal.values
    errors = covariance_of(part)
    signals = [signal[:, c] for c in range(len(chosen))]

    fluctuation = None

    def solve(total: Covariance) -> mixing.Unmixed:
        return mixing.unmix(
            signals,
            [total.part((slice(None), c)) for c in range(len(chosen))],
            target_weights=weights[0],
            water_weights=weights[1],
            water_prior=None,
        )

    solved = solve(errors)
    shots = part.amulor.open_water
    if shots is not None:
        # Each channel's water follows from what is left of it.
        water = signal - np.stack([w * solved.target for w in weights[0]], axis=1)
        size, _ = not_smaller_than_shots_say(part, water)
        fluctuation = fluctuation_of(fit_shots(part, shots)[0], size)
        solved = solve(errors + fluctuation)
    first = saturated_in_any(cube.sel(polarization=[chosen[0]]), part)
    target = solved.target[:, None]
    return target_cube(
        first,
        target,
        solved.independent.part((slice(None), None)),
        terms=present_terms(
            {
                name: solved.error_of(
                    [own.part((slice(None), c)) for c in range(len(chosen))]
                ).part((slice(None), None))
                for name, own in (("counting", errors), ("fluctuation", fluctuation))
                if own is not None
            }
        ),
        water_signal=first.amulor.signal.values - target,
        step=f"reject, unmix {', '.join(chosen)} by Mueller matrices",
    )


def _launched_as(cube: xr.Dataset, launched: str) -> list[str]:
    try:
        stokes.state(launched)
    except ValueError as error:
        raise CubeError(str(error)) from None
    present = cube.amulor.polarizations
    return [name for name in present if name != "none" and name[0] == launched]
