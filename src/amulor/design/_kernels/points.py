"""What the compiled loops are told of each candidate, and what they give back."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Index = NDArray[np.intp]

#: Columns of `Points.number`.
NUMBERS = (
    "rate",  # photoelectrons if all launched light came back [1/s]
    "shot",  # variance of either output per rate, 2 F / T [1/s]
    "dark",  # dark counts [1/s]
    "sky",  # photoelectrons by daylight without an analyser [1/s]
    "echo",  # reflectance over pi, cosine, window [1/sr]
    "passed",  # window [1]
    "phase_floor",  # [rad]
    "fluctuation",  # of the water from sample to sample [1]
    "water_change",  # between shots and scan [1]
    "column_uncertainty",  # of the water behind the target [1]
    "ratio_uncertainty",  # of depolarization ratios [1]
    "departure",  # of the water from the model of the joint estimation [1]
    "reference",  # variance of the fit of the shots over that of one shot [1]
    "shots",  # number of open-water shots [1]
    "pixels",  # number of pixels that share the water [1]
    "per_saturation",  # mean output over the largest linear one, per rate [s]
    "near",  # nearest slant range that is possible [m]
    "far",  # farthest one [m]
    "distance",  # slant range [m]
    "late",  # error of the correction for late light [m]
    "footprint",  # error by uneven light on a slope [m]
    "depth",  # modulation depth [1]
)
(
    RATE,
    SHOT,
    DARK,
    SKY,
    ECHO,
    PASSED,
    FLOOR,
    FLUCTUATION,
    CHANGE,
    COLUMN,
    RATIO,
    DEPARTURE,
    REFERENCE,
    SHOTS,
    PIXELS,
    SATURATION,
    NEAR,
    FAR,
    DISTANCE,
    LATE,
    FOOTPRINT,
    DEPTH,
) = range(len(NUMBERS))

#: Random terms of the phase error, then systematic ones.
RANDOM = ("shot", "dark", "daylight", "phase_floor", "fluctuation", "reference")
(R_SHOT, R_DARK, R_SKY, R_FLOOR, R_FLUCTUATION, R_REFERENCE) = range(6)
SYSTEMATIC = ("drift", "column", "ratio", "shift")
(B_DRIFT, B_COLUMN, B_RATIO, B_SHIFT) = range(4)

#: Columns of the result; the first six are variances [m^2], the next four biases [m].
RESULTS = (
    *RANDOM,
    *SYSTEMATIC,
    "wrong",  # probability of another interval [1]
    "astray",  # mean square error by it [m^2]
    "signal",  # largest target signal of a frequency, photoelectrons [1/s]
    "output",  # mean output over the largest linear one [1]
    "unseen",  # share of the frequencies whose phase is lost in noise [1]
    "channel",  # number of the channel that the range is from [1]
    "tone",  # number of the frequency that is kept, -1 for all [1]
)
(O_WRONG, O_ASTRAY, O_SIGNAL, O_OUTPUT, O_UNSEEN, O_CHANNEL, O_TONE) = range(10, 17)

#: Ways to take the water out.
KEPT, ONE_FREQUENCY, OPEN_WATER, UNMIX, COMBINED, JOINT = range(6)


class Points(NamedTuple):
    """Candidates at distances, one a row."""

    number: Floats
    """`NUMBERS`, shape (point, ...)."""
    look: Index
    """Row of `Light`, shape (point,)."""
    reach: Index
    """Number of the distance, shape (point,)."""
    place: Index
    """Number of the place of the receiver, shape (point,)."""
    tone: Index
    """Numbers of the frequencies of a set, -1 for none, shape (point, K)."""
    target_fraction: Floats
    """Share of the echo that each analyser passes, shape (point, channel) [1]."""
    water_fraction: Floats
    """The same of the water's light [1]."""
    has_analyser: NDArray[np.bool_]
    """Whether a channel has one, shape (channel,)."""


class Light(NamedTuple):
    """Light of all looks, as `amulor.design.column.Columns` has it."""

    overlap: Floats
    """F(d), shape (look, distance) [sr]."""
    mean: Floats
    """Water without modulation, shape (look, distance + 1) [1]."""
    water: NDArray[np.complex128]
    """Water at each frequency, shape (version, look, distance + 1, frequency); the
    first version is the water, the others have a little more absorption and scattering
    [1]."""
    step: float
    """Relative change of absorption and of scattering in these [1]."""
    frequency: Floats
    """Modulation frequencies, shape (frequency,) [Hz]."""
    path: Floats
    """Optical path, shape (place, distance) [m]."""
    slope: Floats
    """Derivative of the slant range by it, shape (place, distance) [1]."""
    offset: Floats
    """Optical path where the water begins, shape (place,) [m]."""


class Scratch(NamedTuple):
    """What a point sees, arrays over (frequency, channel) or one of them."""

    target: NDArray[np.complex128]
    """Target signal [1/s]."""
    water: NDArray[np.complex128]
    """Water in front of it [1/s]."""
    open_water: NDArray[np.complex128]
    """The whole column [1/s]."""
    change: NDArray[np.complex128]
    """Derivatives of the water by the logarithms of absorption and scattering, last
    axis the two; then those of the whole column [1/s]."""
    laser_rate: Floats
    """Photoelectrons by the laser, shape (channel,) [1/s]."""
    sky_rate: Floats
    """By daylight, shape (channel,) [1/s]."""
    open_rate: Floats
    """By the laser without a target, shape (channel,) [1/s]."""
    to_range: Floats
    """Range per phase, 0 where a set has no such frequency, shape (frequency,)
    [m/rad]."""
    variance: Floats
    """Phase variance by `RANDOM`, shape (frequency, 6) [rad^2]."""
    bias: Floats
    """Phase error by `SYSTEMATIC`, shape (frequency, 4) [rad]."""
    size: Floats
    """Modulus of what the phase is taken of, shape (frequency,) [1/s]."""
