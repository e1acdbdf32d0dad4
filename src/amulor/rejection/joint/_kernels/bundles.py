"""Arguments of the compiled loops of the joint estimation, in named tuples.

Complex numbers are pairs (real, imaginary) on the axis before the last, which runs over
the modulation frequencies, so that one loop goes through memory in order. Symbols are
those of `amulor.rejection.joint`: in channel c and at frequency f a pixel shows
A_c H(f) exp(i k p) + s_c W(f, z), with the optical path p out and back, the depth z(p)
where the water ends, and k = 2 pi f / c_0, the phase per optical path.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from numpy.typing import NDArray

Array = NDArray[Any]


class WaterTable(NamedTuple):
    """Water signal W of strength 1 against the depth z where the water ends.

    The dependence on the direction is a sum over components. The node before the last
    serves all depths beyond it, the last one is open water.
    """

    step: float
    """Spacing of the depth nodes [m]."""
    value: Array
    """Water signal W at the nodes, (component, node, 2, frequency) [1]."""
    slope: Array
    """Slope dW/dz at the nodes [1/m]."""


class Echo(NamedTuple):
    """Echo H(f) exp(i k p) of a unit target: phase per path, and transfer function."""

    phase_per_path: Array
    """Wavenumber k = 2 pi f / c_0, (frequency,) [rad/m]."""
    transfer: Array
    """Transfer function H(f) of the echo beyond its delay, (2, frequency) [1]."""


class Model(NamedTuple):
    """Shared parameters, fixed during the path search of a pixel."""

    table: WaterTable
    """Water signal of strength 1."""
    echo: Echo
    """Echo of amplitude 1."""
    gain: Array
    """Strength s of the water signal, (channel, 2, frequency) [V]."""
    fluctuation: float
    """Relative random change of the water signal from sample to sample [1]."""
    front: Array
    """Water signal from depths in front of all targets, in the middle of the scan,
    (channel, 2, frequency) [V]."""
    level: Array
    """Unmodulated open-water signal by component; 1 in the middle of the scan [1]."""


class Samples(NamedTuple):
    """Samples of many pixels and their weights."""

    signal: Array
    """Samples, (pixel, channel, 2, frequency) [V]."""
    weight: Array
    """Inverse covariance (in phase, cross, quadrature), 0 for unusable samples, (pixel,
    channel, 3, frequency) [1/V^2]."""


class Places(NamedTuple):
    """Directions and possible optical paths of many pixels."""

    coefficient: Array
    """Coefficients of the table components, (pixel, component) [1]."""
    offset: Array
    """Round-trip optical path before the water, (pixel,) [m]."""
    shortest: Array
    """Shortest optical path, (pixel,) [m]."""
    longest: Array
    """Longest optical path, (pixel,) [m]."""
    depths: Array
    """Depths at the optical paths shortest + (longest - shortest) (j / (J - 1))^2,
    (pixel, J) [m]."""


class Limits(NamedTuple):
    """Limits of the optical path to a pixel's target, with depths between them."""

    shortest: float
    """Shortest optical path [m]."""
    longest: float
    """Longest optical path [m]."""
    depths: Array
    """Depths at a series of optical paths; see `Places` [m]."""


class Pixel(NamedTuple):
    """Samples, direction and possible optical paths of one pixel."""

    signal: Array
    """Samples, (channel, 2, frequency) [V]."""
    weight: Array
    """Inverse covariance of the samples, (channel, 3, frequency) [1/V^2]."""
    coefficient: Array
    """Coefficients of the table components, (component,) [1]."""
    turn: Array
    """Phasor exp(i k p_0) of the path p_0 before the water, (2, frequency) [1]."""
    limits: Limits
    """Limits of the optical path to the target."""


class Workspace(NamedTuple):
    """Work arrays for the model of one pixel, reused for all pixels."""

    water: Array
    """Water signal of strength 1, (2, frequency) [1]."""
    change: Array
    """Derivative of the water signal with respect to depth [1/m]."""
    phasor: Array
    """Echo of amplitude 1, (2, frequency) [1]."""
    amplitude: Array
    """Best amplitude of the target, (channel,) [V]."""
    influence: Array
    """Shift of the path per unit of each output, (channel, 2, frequency)."""
    weight: Array
    """Inverse covariance with water fluctuation included, (channel, 3, frequency)."""


class Grid(NamedTuple):
    """Coarse grid of optical paths for the search."""

    path: Array
    """Optical paths, at least two [m]."""
    phasor: Array
    """Echo of amplitude 1 at each path, (path, 2, frequency) [1]."""


class Candidates(NamedTuple):
    """Lowest local minima of a pixel's misfit over the optical path."""

    path: Array
    """Optical path [m]."""
    level: Array
    """Misfit on the grid; infinite for unused entries [1]."""
    cost: Array
    """Misfit at the minimum; infinite if the refined path is not a minimum [1]."""
    width: Array
    """Standard deviation of the path at the minimum [m]."""


class Solutions(NamedTuple):
    """Output arrays of the search over the pixels; see `search.Estimates`."""

    path: Array
    amplitude: Array
    cost: Array
    empty_cost: Array
    explained: Array
    information: Array
    lower: Array
    upper: Array
    wrong: Array
    outlying: Array
    next_outlying: Array
    used: Array
    which: Array
    influence: Array
    """Influence of each output on the path; second-last axis (real, imaginary)."""


class Signals(NamedTuple):
    """Output arrays for the water signal at one path of each pixel."""

    depth: Array
    """Depth where the water ends, (pixel,) [m]."""
    water: Array
    """Water signal W, (pixel, 2, frequency) [1]."""
    change: Array
    """Derivative dW/dp with respect to the optical path [1/m]."""


class Derivatives(NamedTuple):
    """Residual and model derivatives of each pixel, complex except the weights."""

    residual: Array
    """Samples less the model, (pixel, channel, frequency) [V]."""
    weight: Array
    """Inverse covariance, with the axes of `Samples.weight` [1/V^2]."""
    base: Array
    """Derivatives by the channel's water strength, (pixel, channel, frequency) [1]."""
    changes: Array
    """Derivatives of W by the shape parameters, (pixel, parameter, frequency) [1]."""
    foreground: Array
    """Water signal of strength 1 in front of all targets, (pixel, frequency) [1]."""
    echo: Array
    """Modeled echo of amplitude 1, without departure, (pixel, frequency) [1]."""
    slope: Array
    """Derivative of W by the optical path, (pixel, frequency) [1/m]."""
    amplitude: Array
    """Amplitude of the target, (pixel, channel), real [V]."""
    is_target: Array
    """Mask of pixels with a path and amplitudes, (pixel,)."""


class Parameters(NamedTuple):
    """Shared parameters, and their positions in the normal equations."""

    strength: Array
    """Strength s_c of the water signal, (channel,) [V]."""
    factor: Array
    """Factor 1 + departure of the echo, complex, (frequency,) [1]."""
    phase_per_path: Array
    """Wavenumber k = 2 pi f / c_0, (frequency,) [rad/m]."""
    first_departure: int
    """Index of the first departure of the water signal."""
    first_echo: int
    """Index of the first departure of the echo."""
    first_doubt: int
    """Index of the first departure of open-water shots; -1 for other samples."""
    is_free: bool
    """Whether the departures are fitted as parameters."""


class Sums(NamedTuple):
    """Normal equations, summed over each portion of the pixels."""

    matrix: Array
    """Information matrix, (portion, parameter, parameter)."""
    vector: Array
    """Negative half gradient of the sum of squares, (portion, parameter)."""
    square: Array
    """Sum of squared errors, (portion,) [1]."""


class WaterModel(NamedTuple):
    """Water signal s W + s d V of each pixel with its derivatives, complex arrays."""

    strength: Array
    """Strength s of each channel, real [V]."""
    gain: Array
    """Strength at each frequency, (channel, frequency) [V]."""
    departure: Array
    """Departure d relative to the strength, (channel, frequency) [1]."""
    foreground: Array
    """Water signal V of strength 1 in front of all targets, (pixel, frequency) [1]."""
    water: Array
    """Water signal W of strength 1, (pixel, frequency) [1]."""
    changes: Array
    """Derivatives of W by the shape parameters, (pixel, parameter, frequency) [1]."""
    covariance: Array
    """Covariance of strength, shape and departure (real, imaginary), shape (channel,
    frequency, parameter, parameter)."""


class Covariances(NamedTuple):
    """Output arrays for sample covariances, (pixel, channel, frequency)."""

    in_phase: Array
    quadrature: Array
    cross: Array
