"""Compiled loop of the joint estimation: which sample of a pixel disagrees most."""

from __future__ import annotations

from amulor.rejection.joint._kernels.bundles import Model, Pixel, Workspace
from amulor.rejection.joint._kernels.options import LANES, inner

#: A sample that leaves less than this of its variance to its residual decides alone
#: what is fitted to it, and cannot be judged [1].
_LEAST_REST = 1e-3


@inner(fastmath=LANES)
def most_outlying(
    rate: float, information: float, pixel: Pixel, model: Model, work: Workspace
) -> tuple[float, float, int]:
    """Return what chi-square falls by without one sample: most, second, and which.

    r' S^-1 r with the residual r of a sample and the covariance S = V - J C J' that
    is left of its own, V, when the path and the amplitude are fitted to it too; exact
    where the model is linear in them. The workspace holds model and amplitudes at the
    path, `rate` is dz/dp. Compiled because every pixel is asked.
    """
    signal, weight, gain = pixel.signal, pixel.weight, model.gain
    water, change, phasor = work.water, work.change, work.phasor
    wavenumber = model.echo.phase_per_path
    most, second, which = 0.0, 0.0, 0
    frequencies = signal.shape[2]
    by_path = work.influence
    for c in range(signal.shape[0]):
        cross, fit = 0.0, 0.0
        a = work.amplitude[c]
        for f in range(frequencies):
            xx, xy, yy = weight[c, 0, f], weight[c, 1, f], weight[c, 2, f]
            g, h = gain[c, 0, f], gain[c, 1, f]
            e, i = phasor[0, f], phasor[1, f]
            p = -a * wavenumber[f] * i + rate * (g * change[0, f] - h * change[1, f])
            q = a * wavenumber[f] * e + rate * (g * change[1, f] + h * change[0, f])
            by_path[c, 0, f], by_path[c, 1, f] = p, q
            cross += p * (xx * e + xy * i) + q * (xy * e + yy * i)
            fit += xx * e * e + 2 * xy * e * i + yy * i * i
        has_echo = a > 0 and fit > 0
        ratio = cross / fit if has_echo else 0.0
        variance = 1 / fit if has_echo else 0.0
        for f in range(frequencies):
            xx, xy, yy = weight[c, 0, f], weight[c, 1, f], weight[c, 2, f]
            determinant = xx * yy - xy * xy
            if not determinant > 0:
                continue
            g, h = gain[c, 0, f], gain[c, 1, f]
            e, i = phasor[0, f], phasor[1, f]
            u = signal[c, 0, f] - g * water[0, f] + h * water[1, f] - a * e
            v = signal[c, 1, f] - g * water[1, f] - h * water[0, f] - a * i
            p = by_path[c, 0, f] - ratio * e
            q = by_path[c, 1, f] - ratio * i
            sxx = yy / determinant - variance * e * e - p * p / information
            sxy = -xy / determinant - variance * e * i - p * q / information
            syy = xx / determinant - variance * i * i - q * q / information
            left = sxx * syy - sxy * sxy
            if not (sxx > 0 and left * determinant > _LEAST_REST):
                continue
            gain_in_fit = (syy * u * u - 2 * sxy * u * v + sxx * v * v) / left
            if gain_in_fit > most:
                second, most = most, gain_in_fit
                which = c * frequencies + f
            elif gain_in_fit > second:
                second = gain_in_fit
    return most, second, which
