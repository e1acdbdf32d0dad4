"""
Target and water interfere
==========================

The signals of the target and of the water in front of the target are two phasors. The
lock-in measures their sum. The error of the range oscillates with the modulation
frequency. The error is zero if the two phasors are parallel. It is largest if they are
nearly perpendicular.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.constants import speed_of_light

from amulor.optics import interference, small_angle, target_echo
from amulor.optics.phase_functions.tables import petzold

GROUP_INDEX, DISTANCE = 1.38, 3.0
frequency = np.linspace(5e6, 200e6, 800)
column = {
    "absorption": 0.2,
    "scattering": 0.6,
    "phase_function": petzold("HAOCE 11"),
    "split_angle": np.pi / 2,
    "baseline": 0.07,
    "tilt": 0.07 / DISTANCE,
    "receiver_radius": 0.02,
    "acceptance_angle": 0.08,
}
water = small_angle.water_response(frequency, group_index=GROUP_INDEX, **column)

# %%
# The phase depends on the optical path: twice the distance times the group index.
# For the darkest target the phase of the sum has jumps. The curve has gaps there.
figure, axes = plt.subplots(2, 1, figsize=(7, 6), sharex=True, layout="constrained")
for reflectance in (0.05, 0.2, 0.8):
    target = target_echo.small_angle_target_response(
        frequency,
        depth=DISTANCE,
        optical_path=2 * GROUP_INDEX * DISTANCE,
        reflectance=reflectance,
        **column,
    )
    total = interference.total_signal(target, water)
    error = np.angle(total / target) * speed_of_light
    error /= 4 * np.pi * frequency * GROUP_INDEX
    error[np.r_[False, np.abs(np.diff(error)) > 0.1]] = np.nan
    axes[0].plot(frequency / 1e6, np.abs(total) / np.abs(target))
    axes[1].plot(frequency / 1e6, 1e3 * error, label=f"reflectance {reflectance:.0%}")
axes[0].set(ylabel="amplitude over that of the target")
axes[1].set(xlabel="modulation frequency [MHz]", ylabel="error of the range [mm]")
axes[1].axhline(0, color="0.6", linewidth=0.6)
axes[1].legend()
plt.show()
