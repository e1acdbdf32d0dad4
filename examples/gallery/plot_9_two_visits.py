"""
Two visits to a site
====================

Has it moved, or is it the error? A sea bed with an amphora, scanned from two places in
each of two years; in between the amphora was pushed by 4 cm. Scans are registered with
the covariance of their poses, merged, and compared with the errors they state.
"""

import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

sys.path.insert(0, str(Path("../wreck").resolve()))

import make_site

from amulor.site import Site
from amulor.site.change.distances import change
from amulor.site.merging.cloud import merge
from amulor.site.registration.register import register, surfaces_of

# %%
# Two scans of each visit of ``examples/wreck``, with coarse pixels.
make_site.STATIONS = {
    year: stations[:2] for year, stations in make_site.STATIONS.items()
}
make_site.MOVED = np.array([0.030, 0.026, 0.0])
site = Site.from_toml(make_site.make(Path(tempfile.mkdtemp()), rows=60))
surfaces, images = surfaces_of(site)
found = register(site, surfaces=surfaces, images=images)
cloud = merge(site, found, surfaces, images)
changed = change(site, found, surfaces, cloud)
print(f"{int(changed.significant.sum())} points changed, of {changed.value.size}")

# %%
# What rose is blue, what sank is red: the amphora has left one place and lies in
# another. On the right in standard uncertainties; rings mark what counts as changed,
# beyond what chance makes of all points together.
known = np.isfinite(changed.value)
x, y = changed.position[known, :2].T
value, stated = 1e3 * changed.value[known], 1e3 * changed.uncertainty[known]
figure, axes = plt.subplots(1, 2, figsize=(9.5, 4.4), layout="constrained")
for axis, shown, limit, title in (
    (axes[0], value, 12, "change [mm]"),
    (axes[1], value / stated, 6, "change over its uncertainty"),
):
    points = axis.scatter(x, y, c=shown, s=9, cmap="RdBu", vmin=-limit, vmax=limit)
    figure.colorbar(points, ax=axis, shrink=0.6)
    axis.set(title=title, xlabel="east [m]", ylabel="north [m]", aspect="equal")
far = changed.significant[known]
axes[1].scatter(x[far], y[far], s=14, facecolors="none", edgecolors="k", linewidths=0.6)
plt.show()
