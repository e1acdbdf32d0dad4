"""
Real light through foam
=======================

These histograms of single photons were measured through slabs of polyurethane foam.
Their Fourier transform is the signal of a modulated laser, at every frequency at once.
Light through a thicker slab is later, and its cut-off is lower.

Data: D. B. Lindell, G. Wetzstein, Nat. Commun. 11, 4517 (2020), MIT license.
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
# Amplitudes are relative to zero frequency. A delay becomes a phase.
figure, axes = plt.subplots(2, 1, figsize=(7, 6), sharex=True, layout="constrained")
delays = mean_delay(slabs)
for number, thickness in enumerate(slabs.thickness):
    slab = response.isel(thickness=number)
    color = plt.colormaps["viridis"](number / len(slabs.thickness))
    axes[0].loglog(
        frequency / 1e6,
        slab["amplitude"],
        color=color,
        label=f"{100 * thickness:.1f} cm",
    )
    axes[1].semilogx(frequency / 1e6, np.unwrap(slab["phase"]), color=color)
    print(f"{100 * thickness:5.2f} cm: mean delay {1e9 * delays[number]:6.2f} ns")
axes[0].set(ylabel="amplitude over that at 0 MHz", ylim=(1e-3, 1.2))
axes[0].legend(ncols=3, fontsize="small")
axes[1].set(xlabel="modulation frequency [MHz]", ylabel="phase [rad]")
plt.show()
