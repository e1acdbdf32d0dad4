"""
An amphora compared with its model
==================================

This example compares a measured surface with the true surface, and the errors with
their stated uncertainty. The object is an amphora of 30 cm in harbor water, scanned in
a simulation from 1.5 m.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import amulor
from amulor import imaging, rejection

survey = amulor.Survey.from_toml(Path("../amphora/amphora.toml"))
samples = amulor.simulate(survey, rng=2)
image = imaging.range_image(rejection.open_water(samples))
truth = samples["truth_slant_range"].values
good = (image["quality_flag"].values == 0) & np.isfinite(truth)

# %%
# The histogram shows the errors divided by their stated uncertainties. It is narrower
# than the normal distribution with a standard deviation of 1 (line). The reason is that
# the stated uncertainty includes delay, geometry and group index from
# ``[calibration]``, but the simulated instrument has no error in these quantities.
error = (image["slant_range"].values - truth)[good]
stated = image["slant_range_uncertainty"].values[good]
print(f"{good.sum()} pixels trusted, of {np.isfinite(truth).sum()} on the amphora")
print(f"error {1e3 * error.std():.2f} mm, stated {1e3 * np.median(stated):.2f} mm")

figure, axes = plt.subplots(1, 3, figsize=(10, 4.2), layout="constrained")
shown = axes[0].imshow(image["slant_range"].where(good), cmap="viridis")
figure.colorbar(shown, ax=axes[0], label="distance [m]")
off = np.where(good, 1e3 * (image["slant_range"].values - truth), np.nan)
shown = axes[1].imshow(off, cmap="RdBu", vmin=-2, vmax=2)
figure.colorbar(shown, ax=axes[1], label="error [mm]")
for axis, title in zip(axes[:2], ("distance", "error"), strict=True):
    axis.set(title=title, xlabel="column", ylabel="row")
places = np.linspace(-4, 4, 41)
axes[2].hist(error / stated, bins=places, density=True, color="0.7")
axes[2].plot(places, np.exp(-(places**2) / 2) / np.sqrt(2 * np.pi), color="C1")
axes[2].set(
    title="errors and normal distribution",
    xlabel="error over standard uncertainty", ylabel="probability density",
)  # fmt: skip
plt.show()
