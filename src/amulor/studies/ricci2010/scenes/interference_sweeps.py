"""Three frequency sweeps of section 8 of the paper: a white plate in the long tank."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from amulor import cube as cubes
from amulor import rejection
from amulor.optics import extrema, interference
from amulor.simulation import DiffusionModel, SmallAngleModel, simulate
from amulor.studies.ricci2010.scenes.water_sweeps import (
    asymmetry,
    forward_fraction,
)
from amulor.studies.ricci2010.study import Study
from amulor.survey import Survey

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

EXPERIMENTS = (1, 2, 3)
#: How the panels of figures 7 to 9 are named.
TITLES = tuple(f"experiment {number}" for number in EXPERIMENTS)
#: Which turbidity each experiment had: low, high, low.
TURBIDITY = {1: "low", 2: "high", 3: "low"}
#: Sweep of section 8: first and last frequency [Hz], and how many.
FIRST, LAST, COUNT = 0.5e6, 146e6, 196
QUICK_COUNT = 98
#: Reflectance of white paint [1].
WHITE = 0.8
#: Width over which a measured sweep is smoothed before its extrema are sought, less
#: than half of the shortest period [Hz].
_SMOOTHED = 11e6
#: Joint estimation takes so many of the frequencies: enough for the range.
_JOINT_COUNT = 28

_SURVEY = """
name = "Ricci et al. 2010, experiment {number} of section 8"
[water]
absorption = "{absorption} 1/m"
scattering = "{scattering} 1/m"
forward_fraction = {forward_fraction}
second_moment = "{second_moment} rad^2"
phase_function_at_180 = "{backscatter} 1/sr"
asymmetry = {asymmetry}
split_angle = "{split_angle} rad"
refractive_index = {index}
group_index = {index}
column_end = "{length} m"
[[targets]]
kind = "plate"
position = ["0 m", "0 m", "{distance} m"]
width = "44 cm"
height = "34 cm"
reflectance = {reflectance}
[instrument]
phase_uncertainty = "0 deg"
wavelength = "{wavelength} m"
power = "{power} W"
modulation_depth = {modulation_depth}
modulation_frequencies = [{frequencies}]
polarizations = ["none"]
[instrument.receiver]
position = ["{baseline} m", "0 m", "0 m"]
radius = "{receiver_radius} m"
acceptance = "{acceptance} rad"
[instrument.detector]
saturation = "1e3 V"
[instrument.lock_in]
time_constant = "10 ms"
phase_floor = "{phase_noise} rad"
[scan]
columns = 1
rows = 1
azimuth_span = "0 deg"
elevation_span = "0 deg"
dwell = "125 ms"
[scan.open_water]
columns = 1
rows = 1
repeats = 20
"""


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """Synthetic frequency sweep of one experiment, with target signals by method."""

    number: int
    """Number of the experiment."""
    distance: float
    """Target distance [m]."""
    frequency: Floats
    """Modulation frequencies [Hz]."""
    signal: Complex
    """Measured signal with the target [V]."""
    water: Complex
    """Measured open-water signal, without the target [V]."""
    subtracted: Complex
    """Target signal by open-water subtraction [V]."""
    joint_frequency: Floats
    """Modulation frequencies used by joint estimation [Hz]."""
    joint: Complex
    """Target signal by joint estimation, without open-water measurements [V]."""
    joint_range: tuple[float, float, float]
    """Slant range by joint estimation, its uncertainty, and the true range [m]."""
    joint_flags: int
    """Quality flags of the joint estimate."""
    truth: Complex
    """True target signal, without noise and water [V]."""
    reflectance: float
    """Plate reflectance for the paper's ratio of water signal to echo [1]."""
    needed_backscatter: float
    """Phase function at 180 degrees for the paper's ratio [1/sr].

    For a white plate of reflectance 0.8.
    """
    period: float
    """Expected frequency period of the interference [Hz]."""

    @property
    def ratio(self) -> Floats:
        """Ratio of total signal to water signal, eq. (54)."""
        return interference.signal_to_optical_noise_ratio(self.signal, self.water)

    @property
    def corrected_ratio(self) -> Floats:
        """Ratio of water-subtracted target signal to water signal, eq. (58)."""
        return interference.signal_to_optical_noise_ratio(self.subtracted, self.water)

    @property
    def contrast(self) -> Floats:
        """Contrast between total signal and water signal, eq. (54)."""
        return interference.contrast(self.signal, self.water)

    @property
    def corrected_contrast(self) -> Floats:
        """Contrast between water-subtracted signal and water signal, eq. (58)."""
        return interference.contrast(self.subtracted, self.water)


def shown(sweep: Sweep) -> slice:
    """Return the slice of samples to draw, with space between markers."""
    return slice(None, None, max(1, len(sweep.frequency) // 65))


def smoothed(value: Floats) -> Floats:
    """Smooth a quantity over frequency, for the detection of extrema in noise."""
    count = round(_SMOOTHED * (len(value) - 1) / (LAST - FIRST))
    fitted: Floats = savgol_filter(value, count + 1 - count % 2, 2)
    return fitted


def sweeps(study: Study) -> tuple[Sweep, ...]:
    """Simulate the frequency sweeps of all three experiments."""
    return tuple(study.once(_DIFFUSION[number]) for number in EXPERIMENTS)


def small_angle_sweeps(study: Study) -> tuple[Sweep, ...]:
    """Simulate the frequency sweeps by the small-angle model, eq. (29)."""
    return tuple(study.once(_SMALL_ANGLE[number]) for number in EXPERIMENTS)


def _experiment(
    study: Study, *, number: int, model: DiffusionModel | SmallAngleModel
) -> Sweep:
    frequency = np.linspace(FIRST, LAST, QUICK_COUNT if study.quick else COUNT)
    distance = study[f"distance_{number}"]
    # The echo is proportional to the reflectance, so one trial settles it.
    trial = simulate(
        _survey(study, number, frequency, reflectance=0.3), rng=0, model=model
    )
    mean = float((_water(trial) / np.abs(_target(trial))).mean())
    reflectance = 0.3 * mean / study[f"mean_ratio_{number}"]
    survey = _survey(study, number, frequency, reflectance=reflectance)
    cube = simulate(survey, rng=study.rng(f"sweep {number}"), model=model)
    interval = (distance - 1.0, distance + 1.0)
    subtracted = rejection.open_water(cube, interval=interval)
    recorded = cubes.without_groups(cube).isel(
        modulation_frequency=slice(None, None, len(frequency) // _JOINT_COUNT)
    )
    # A single pixel cannot constrain the receiver direction; here it is known.
    joint = rejection.joint(
        recorded, interval=interval, receiver_direction_uncertainty=0.0
    )
    shots = cube.amulor.open_water
    water = (shots["in_phase"] + 1j * shots["quadrature"]).mean("shot")
    water_signal = water.values.ravel()
    # Smoothed, since the derivative of the phase makes much of noise.
    depth = extrema.group_depth(
        frequency,
        smoothed(water_signal.real) + 1j * smoothed(water_signal.imag),
        group_index=study["index"],
    )
    inner = (frequency > 20e6) & (frequency < 120e6)
    return Sweep(
        number=number,
        distance=distance,
        frequency=frequency,
        signal=cube.amulor.signal.values.ravel(),
        water=water_signal,
        subtracted=subtracted.amulor.signal.values.ravel(),
        joint_frequency=recorded["modulation_frequency"].values,
        joint=joint.amulor.signal.values.ravel(),
        joint_range=(
            float(joint["joint_slant_range"].item()),
            float(joint["joint_slant_range_uncertainty"].item()),
            float(cube.amulor.truth["slant_range"].item()),
        ),
        joint_flags=int(np.bitwise_or.reduce(joint["quality_flag"].values.ravel())),
        truth=_target(cube),
        reflectance=reflectance,
        needed_backscatter=study["long_backscatter"] * WHITE / reflectance,
        period=float(
            extrema.separation(
                distance,
                group_depth=np.median(depth[inner]),
                group_index=study["index"],
            )
        ),
    )


_DIFFUSION, _SMALL_ANGLE = (
    {number: partial(_experiment, number=number, model=model) for number in EXPERIMENTS}
    for model in (DiffusionModel(), SmallAngleModel())
)


def _survey(
    study: Study, number: int, frequency: Floats, *, reflectance: float
) -> Survey:
    turbidity = TURBIDITY[number]
    attenuation = study[f"attenuation_{turbidity}"]
    moment = study[f"second_moment_{turbidity}"]
    # More than all light cannot come back: then the water scatters less instead, which
    # leaves every ratio as it is.
    possible = min(reflectance, 1.0)
    return Survey.from_text(
        _SURVEY.format(
            number=number,
            absorption=attenuation * study["absorption_share"],
            scattering=attenuation * (1 - study["absorption_share"]),
            second_moment=moment,
            forward_fraction=forward_fraction(moment, split_angle=study["split_angle"]),
            backscatter=study["long_backscatter"] * possible / reflectance,
            asymmetry=asymmetry(moment, split_angle=study["split_angle"]),
            split_angle=study["split_angle"],
            index=study["index"],
            length=study["long_length"],
            distance=study[f"distance_{number}"],
            reflectance=possible,
            wavelength=study["wavelength"],
            power=study["power"],
            modulation_depth=study["modulation_depth"],
            frequencies=", ".join(f'"{f / 1e6:.6f} MHz"' for f in frequency),
            baseline=study["long_baseline"],
            receiver_radius=study["receiver_radius"],
            acceptance=study["acceptance"],
            phase_noise=study["phase_noise"],
        )
    )


def _target(cube: xr.Dataset) -> Complex:
    truth = cube.amulor.truth
    signal: Complex = (
        truth["target_in_phase"] + 1j * truth["target_quadrature"]
    ).values
    return signal.ravel()


def _water(cube: xr.Dataset) -> Floats:
    truth = cube.amulor.truth
    amplitude: Floats = np.hypot(
        truth["water_in_phase"], truth["water_quadrature"]
    ).values
    return amplitude.ravel()
