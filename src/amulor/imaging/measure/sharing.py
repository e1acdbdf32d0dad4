"""How the error of the reference spreads over a scan, in a few numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def reference_basis(
    azimuth: ArrayLike, elevation: ArrayLike, *, degree: int
) -> dict[str, Any]:
    r"""Return the basis in which errors of a polynomial reference correlate.

    Parameters
    ----------
    azimuth, elevation : array_like, shape (row, column)
        Directions of the scan [rad].
    degree : int
        Of the polynomial.

    Returns
    -------
    dict
        `middle` and `factor` of the two angles, `powers` of the monomials, and
        `matrix`, which turns the monomials of a pixel into a vector; the errors of two
        pixels correlate like the cosine between their vectors.

    Notes
    -----
    As `amulor.imaging.correlation.covariance`: :math:`\phi_i^T (\Phi^T \Phi)^{-1}
    \phi_j` over its diagonal, by the singular values of :math:`\Phi`. For programs
    that work out a covariance by themselves, such as a saved page.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor import imaging
    >>> azimuth, elevation = np.linspace(-1, 1, 4), np.zeros(4)
    >>> basis = imaging.measure.reference_basis(azimuth, elevation, degree=1)
    >>> basis["powers"]
    [[0, 0], [0, 1], [1, 0]]
    """
    middle, factor, axes = [], [], []
    for angles in (azimuth, elevation):
        values = np.asarray(angles, dtype=float)
        span = float(np.ptp(values))
        middle.append(float(values.mean()))
        factor.append(2 / span if span > 0 else 0.0)
        axes.append((values - middle[-1]) * factor[-1])
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    columns = np.stack([(axes[0] ** i * axes[1] ** j).ravel() for i, j in powers], 1)
    _, singular, turned = np.linalg.svd(columns, full_matrices=False)
    kept = singular > 1e-9 * singular[0]
    matrix = turned[kept].T / singular[kept]
    return {
        "middle": middle,
        "factor": factor,
        "powers": [list(power) for power in powers],
        "matrix": matrix.tolist(),
    }
