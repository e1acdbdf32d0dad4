"""
Four forms of the water signal
==============================

The higher the modulation frequency, the weaker the water signal. At the cut-off the
water signal has half its power. Four models compute the water signal for the same
water. They are the small-angle form with the whole phase function, its closure, the
diffusion form of Ricci et al. 2010, and photon transport with all orders of scattering.
"""

import matplotlib.pyplot as plt
import numpy as np

from amulor.optics import small_angle, small_angle_closure, small_angle_diffusion
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.transport import DiscReceiver, Layer, Medium, Source, simulate

ABSORPTION, SCATTERING, GROUP_INDEX = 0.15, 0.35, 1.38
SPLIT = np.pi / 2
phase_function = henyey_greenstein_function(asymmetry=0.95)
receiver = {"receiver_radius": 0.02, "acceptance_angle": 0.08, "baseline": 0.07}
frequency = np.linspace(0, 150e6, 31)

# %%
# The small-angle form and its closure use the whole phase function. The diffusion form
# uses only the fraction of forward scattering and the mean square angle of this part.
water = {"absorption": ABSORPTION, "scattering": SCATTERING}
whole = {**water, "phase_function": phase_function, "split_angle": SPLIT, **receiver}
forward, second_moment = phase_function.forward_split(SPLIT)
at_180 = SCATTERING * float(phase_function(np.array([np.pi]))[0])
forms = {
    "small-angle (29)": small_angle.water_response(
        frequency, group_index=GROUP_INDEX, **whole
    ),
    "closure": small_angle_closure.water_response(
        frequency, group_index=GROUP_INDEX, **whole
    ),
    "diffusion (46)": small_angle_diffusion.water_response(
        frequency,
        absorption=ABSORPTION,
        forward_scattering=forward * SCATTERING,
        diffuse_scattering=(1 - forward) * SCATTERING,
        second_moment=second_moment,
        backscatter_vsf=at_180,
        group_index=GROUP_INDEX,
        **receiver,
    ),
}

# %%
# Photon transport simulates random photon paths. The scatter between batches of paths
# gives its error. The receiver is a disc with sharp edges.
tally = simulate(
    Medium(
        layers=[Layer(**water, phase_function=phase_function)], group_index=GROUP_INDEX
    ),
    Source(),
    DiscReceiver(radius=0.02, acceptance_angle=0.08, position=(0.07, 0, 0)),
    frequency[::3],
    histories=100_000,
    seed=1,
)
signal = np.abs(tally.water_signal)

figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for name, response in forms.items():
    axes.plot(frequency / 1e6, np.abs(response) / np.abs(response[0]), label=name)
axes.plot(frequency[::3] / 1e6, signal / signal[0], "ko", label="photons")
axes.axhline(np.sqrt(0.5), color="0.6", linestyle=":", label="half power")
axes.set(xlabel="modulation frequency [MHz]", ylabel="water signal over that at 0 MHz")
axes.legend()
plt.show()
