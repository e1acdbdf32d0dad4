"""
Five rejection methods on one scan
==================================

A simulated instrument scans a dark plate in turbid water with three modulation
frequencies and two polarization channels. Five methods are applied to the same scan.
The cube contains the true distance, but no method uses it.
"""

import matplotlib.pyplot as plt
import numpy as np

import amulor
from amulor import imaging, rejection

survey = amulor.Survey.from_text(
    """
name = "Dim plate"
[water]
absorption = "0.2 1/m"
scattering = "0.6 1/m"
asymmetry = 0.95
temperature = "20 degC"
salinity = 0
signal_fluctuation = "2 %"
backscatter_mueller = [0.9, -0.9, -0.8]
[[targets]]
kind = "plate"
position = ["0 m", "0 m", "2 m"]
width = "30 cm"
height = "30 cm"
reflectance = 0.1
[instrument]
wavelength = "405 nm"
power = "20 mW"
modulation_depth = 0.8
modulation_frequencies = ["20 MHz", "40 MHz", "80 MHz"]
polarizations = ["VV", "VH"]
[instrument.receiver]
position = ["7 cm", "0 m", "0 m"]
azimuth = "-2 deg"
radius = "2 cm"
acceptance = "0.08 rad"
[instrument.detector]
optical_transmission = "10 %"
[instrument.lock_in]
time_constant = "10 ms"
phase_floor = "0.06 deg"
[scan]
columns = 30
rows = 20
azimuth_span = "6 deg"
elevation_span = "4 deg"
dwell = "125 ms"
[scan.open_water]
columns = 5
rows = 5
repeats = 6
"""
)
samples = amulor.simulate(survey, rng=1)

# %%
# The method ``nothing`` leaves the water signal in the samples. The crossed channel
# needs no open-water reference. Subtraction and combination use the open-water
# reference. Joint estimation fits target, distance and water together.
methods = {
    "nothing": rejection.keep_water,
    "crossed": rejection.cross_polarized,
    "open water": rejection.open_water,
    "combined": rejection.combined,
    "joint": rejection.joint,
}
images = {}
for name, method in methods.items():
    target = method(samples)
    channel = (
        "VV" if "VV" in target["polarization"] else target["polarization"].values[0]
    )
    images[name] = imaging.range_image(target, polarization=str(channel))

# %%
# For the pixels without a flag, the table compares the true error with the stated
# uncertainty. The 95 % interval should contain the true distance of about 95 % of these
# pixels.
truth = samples["truth_slant_range"].values
print("method        trusted  error [mm]  stated [mm]  inside 95 %")
for name, image in images.items():
    good = (image["quality_flag"].values == 0) & np.isfinite(truth)
    if not good.any():
        print(f"{name:<12}{0:>8}%   each pixel is flagged")
        continue
    error = (image["slant_range"].values - truth)[good]
    stated = image["slant_range_uncertainty"].values[good]
    print(
        f"{name:<12}{100 * good.sum() / np.isfinite(truth).sum():>8.0f}%"
        f"{1e3 * np.sqrt(np.mean(error**2)):>12.2f}{1e3 * np.median(stated):>13.2f}"
        f"{100 * np.mean(abs(error) < 1.96 * stated):>12.0f}%"
    )

figure, axes = plt.subplots(1, len(images), figsize=(11, 2.6), layout="constrained")
for axis, (name, image) in zip(axes, images.items(), strict=True):
    off = 1e3 * (image["slant_range"].values - truth)
    shown = axis.imshow(off, cmap="RdBu", vmin=-15, vmax=15)
    axis.set(title=name, xlabel="column")
axes[0].set(ylabel="row")
figure.colorbar(shown, ax=axes, label="error [mm]")
plt.show()
