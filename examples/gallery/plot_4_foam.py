"""
Real light through foam
=======================

Histograms of single photons through slabs of polyurethane foam are what a modulated
laser would have seen at every frequency at once: their Fourier transform. The thicker
the slab, the later the light, and the lower its cut-off.

Data: D. B. Lindell, G. Wetzstein, Nat. Commun. 11, 4517 (2020), MIT licence.
"""

import tempfile

import matplotlib.pyplot as plt
import numpy as np

from amulor import samples
from amulor.io import mean_delay, read_slabs, slab_response

path, _ = samples.copy("foam-slabs", tempfile.mkdtemp())
slabs = read_slabs(path)
frequency = np.geomspace(5e6, 1e9, 120)
response = slab_response(slabs, frequency)

# %%
# Amplitudes are relative to zero frequency; a delay turns into phase.
figure, axes = plt.subplots(2, 1, figsize=(7, 6), sharex=True, layout="constrained")
delays = mean_delay(slabs)
for number, thickness in enumerate(slabs.thickness):
    one = response.isel(thickness=number)
    colour = plt.colormaps["viridis"](number / len(slabs.thickness))
    axes[0].loglog(
        frequency / 1e6,
        one["amplitude"],
        color=colour,
        label=f"{100 * thickness:.1f} cm",
    )
    axes[1].semilogx(frequency / 1e6, np.unwrap(one["phase"]), color=colour)
    print(f"{100 * thickness:5.2f} cm: mean delay {1e9 * delays[number]:6.2f} ns")
axes[0].set(ylabel="amplitude, relative", ylim=(1e-3, 1.2))
axes[0].legend(ncols=3, fontsize="small")
axes[1].set(xlabel="modulation frequency [MHz]", ylabel="phase [rad]")
plt.show()
