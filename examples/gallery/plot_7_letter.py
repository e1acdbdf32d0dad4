"""
A letter behind foam, measured
==============================

Measured light that comes with the package: a letter U behind an inch of polyurethane
foam, recorded at two distances as histograms of single photons. What the
two recordings share is the foam; taken out, like open water, it leaves the letter at
its distance. Its shape stays a blur, which the foam makes of it: to read it takes the
tomography of the authors.

Data: D. B. Lindell, G. Wetzstein, Nat. Commun. 11, 4517 (2020), MIT licence. It is foam
in air, where light diffuses, not water, where most of it scatters once.
"""

import tempfile

import matplotlib.pyplot as plt
import numpy as np

from amulor import cube as cubes
from amulor import imaging, rejection, samples
from amulor.io import medium_from_minimum, read_transients

[path] = samples.copy("foam-letter-u", tempfile.mkdtemp())
FREQUENCY = [100e6]
foam = medium_from_minimum(path, FREQUENCY)

# %%
# The Fourier coefficient of a histogram at 100 MHz is what a lock-in would read.
figure, axes = plt.subplots(2, 3, figsize=(8.4, 5.2), layout="constrained")
ranges = []
for row, label in enumerate(("54 cm", "78 cm")):
    cube = read_transients(path, FREQUENCY, scene=row)
    cube = cubes.attach(cube, foam, "open_water")
    target = rejection.open_water(cube)
    image = imaging.range_image(target)
    before = np.squeeze(cube.amulor.amplitude.values)
    after = np.squeeze(target.amulor.amplitude.values)
    bright = after > 0.35 * np.nanmax(after)
    distance = np.where(bright, image["slant_range"].values, np.nan)
    ranges.append(np.nanmedian(distance))
    for axis, values in zip(axes[row], (before, after, 100 * distance), strict=True):
        shown = axis.imshow(values, cmap="viridis")
        axis.set(xticks=[], yticks=[])
        figure.colorbar(shown, ax=axis, shrink=0.85)
    axes[row, 0].set_ylabel(f"letter at {label}")
for axis, title in zip(
    axes[0],
    ("amplitude, foam and letter", "foam taken out", "distance [cm]"),
    strict=True,
):
    axis.set_title(title)
print(f"step between the two: {100 * (ranges[1] - ranges[0]):.1f} cm, 24 cm stated")
plt.show()
