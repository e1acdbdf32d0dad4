"""
Real light through foam
=======================

The data are histograms of photon arrival times, measured through slabs of polyurethane
foam. The Fourier transform of a histogram is the signal of a modulated laser at all
frequencies. The thicker the slab, the later the light arrives, and the lower the
cut-off.

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
# Amplitudes are divided by the amplitude at zero frequency. At low frequencies, the
# phase is the mean delay times the angular frequency of the modulation.
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
