"""
Read a letter behind foam
=========================

A cardboard letter S is hidden behind an inch of polyurethane foam. A pulsed laser and a
photon counter scanned the letter. The Fourier transform of a recorded histogram is the
signal of a modulated laser at all frequencies. At 100 MHz the letter is not legible.
The letter becomes legible if many frequencies up to 3.5 GHz are focused behind the
foam.

Data: D. B. Lindell, G. Wetzstein, Nat. Commun. 11, 4517 (2020), MIT license. Foam
scatters light many times. In water, most of the returned light is scattered once.
"""

import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

sys.path.insert(0, str(Path("..").resolve()))

import foam_transients

from amulor import cube as cubes
from amulor import imaging, rejection, samples
from amulor.io import medium_from_minimum, read_slabs, read_transients

# %%
# The script ``examples/foam_transients.py`` divides the signal by the response of an
# inch of foam. This response was measured through slabs. The script then focuses the
# signal on points behind the foam.
folder = Path(tempfile.mkdtemp())
letter, _ = samples.copy("foam-letters", folder)
slab, _ = samples.copy("foam-slabs", folder)
cube = read_transients(letter, foam_transients.BAND)
low = read_transients(letter, [100e6])
volume = foam_transients.refocus(cube, foam_transients.foam_twice(read_slabs(slab)))
pictures = {
    "100 MHz": np.squeeze(low.amulor.amplitude.values),
    "1 GHz": cube.amulor.amplitude.values[0, 0],
    "1 to 3.5 GHz, focused": volume.max(axis=0),
}
right, down = 100 * cube["origin_x"].values, 100 * cube["origin_y"].values
figure, axes = plt.subplots(1, 3, figsize=(8, 3), sharey=True, layout="constrained")
for axis, (title, amplitude) in zip(axes, pictures.items(), strict=True):
    shown = axis.pcolormesh(
        right, down, amplitude / amplitude.max(), cmap="gray", vmin=0, vmax=1
    )
    axis.set(title=title, xlabel="right [cm]", aspect="equal")
axes[0].set(ylabel="down [cm]")
axes[0].invert_yaxis()
figure.colorbar(shown, ax=axes, label="amplitude, relative")
plt.show()

# %%
# A measurement of distances needs no focusing. A letter U was recorded at 54 cm and at
# 78 cm behind the foam. Both recordings contain the signal of the foam. This common
# signal is subtracted like open water.
[path] = samples.copy("foam-letter-u", folder)
foam = medium_from_minimum(path, [100e6])
distances = []
for scene in (0, 1):
    scan = cubes.attach(read_transients(path, [100e6], scene=scene), foam, "open_water")
    image = imaging.range_image(rejection.open_water(scan))
    bright = image["intensity"] > 0.35 * image["intensity"].max()
    distances.append(float(image["slant_range"].where(bright).median()))
print(f"distance of the two letters {100 * (distances[1] - distances[0]):.1f} cm")
print("true distance 24 cm")
