"""
Which modulation frequency?
===========================

The higher the modulation frequency, the smaller the noise of a range. The error by
residual water oscillates with the modulation frequency. Each map shows the combined
error against distance and frequency, and helps to choose the frequency. The example
assumes an open-water reference that is wrong by 3 %. The two maps are for two
turbidities.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LogNorm
from scipy.constants import speed_of_light

from amulor.optics import detection, ranging, small_angle, target_echo
from amulor.optics.phase_functions.tables import petzold

GROUP_INDEX, DWELL, LEFT = 1.38, 10e-3, 0.03
frequency = np.linspace(10e6, 200e6, 96)
distance = np.linspace(1.0, 5.0, 60)
rate = detection.photoelectron_rate(
    20e-3 * 0.1, wavelength=405e-9, quantum_efficiency=0.25
)

# %%
# All arrays are broadcast: distances along the first axis, frequencies along the
# second.
figure, axes = plt.subplots(1, 2, figsize=(9, 3.8), sharey=True, layout="constrained")
for axis, attenuation in zip(axes, (0.3, 1.0), strict=True):
    column = {
        "absorption": 0.3 * attenuation,
        "scattering": 0.7 * attenuation,
        "phase_function": petzold("HAOCE 11"),
        "split_angle": np.pi / 2,
        "baseline": 0.07,
        "tilt": 0.03,
        "receiver_radius": 0.02,
        "acceptance_angle": 0.08,
    }
    target = target_echo.small_angle_target_response(
        frequency, depth=distance[:, None],
        optical_path=2 * GROUP_INDEX * distance[:, None], reflectance=0.2, **column,
    )  # fmt: skip
    water = small_angle.water_response(frequency, group_index=GROUP_INDEX, **column)
    steady = small_angle.water_response(0.0, group_index=GROUP_INDEX, **column)
    light = np.abs(target) + np.abs(steady)
    counts = rate * DWELL * light
    noise = ranging.photon_limited_uncertainty(
        counts, modulation_depth=0.8 * np.abs(target) / light,
        modulation_frequency=frequency, group_index=GROUP_INDEX,
    )  # fmt: skip
    turn = np.angle(1 + LEFT * water / target)
    left = turn * speed_of_light / (4 * np.pi * frequency * GROUP_INDEX)
    total = 1e3 * np.hypot(noise, left)
    shown = axis.pcolormesh(
        frequency / 1e6, distance, total, norm=LogNorm(0.03, 30), cmap="cividis"
    )
    axis.contour(
        frequency / 1e6, distance, total, [1, 10], colors="w", linestyles=["-", "--"]
    )
    best = frequency[total.argmin(axis=1)] / 1e6
    print(
        f"{attenuation} 1/m: best at 2 m {best[np.argmin(abs(distance - 2))]:.0f} MHz"
    )
    axis.set(
        title=f"attenuation {attenuation} 1/m", xlabel="modulation frequency [MHz]"
    )
axes[0].set(ylabel="distance [m]")
figure.colorbar(shown, ax=axes, label="error of the range [mm]")
plt.show()
