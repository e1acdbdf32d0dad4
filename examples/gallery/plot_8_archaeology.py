"""
Raking light, section and drawing
=================================

This example makes three drawings of a find: a relief under raking light, contour lines,
and a section with its uncertainty. The find is the amphora of the sample data, recorded
in a simulation with two modulation frequencies in harbor water.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LightSource

from amulor import pipeline, samples
from amulor.imaging import products

INTERVAL = (1.2, 1.8)
image = pipeline.run(samples.cube("amphora"), method="open-water", interval=INTERVAL)

# %%
# The projection is orthographic, from the front, with cells of two millimeters.
surface = products.surface(image)
front = products.plane_of(surface.frame)
drawn = products.raster(surface, front, cell=2e-3)
extent = 100 * np.array(
    [drawn.columns[0], drawn.columns[-1], drawn.rows[-1], drawn.rows[0]]
)
place = np.linspace(drawn.columns[0], drawn.columns[-1], 5)[[0, -1]]
level = float(drawn.rows[np.isfinite(drawn.height).sum(axis=1).argmax()])
cut = products.section(surface, front, start=(place[0], level), end=(place[1], level))
lines = products.contours(drawn, interval=5e-3)

# %%
# Raking light at 20 degrees above the surface shows relief that the amplitude does not
# show.
figure, panels = plt.subplot_mosaic(
    [["light", "lines", "cut"], ["light", "lines", "error"]],
    figsize=(10, 5), layout="constrained", width_ratios=(1, 1, 1.3),
)  # fmt: skip
axes = list(panels.values())
height = np.where(np.isfinite(drawn.height), drawn.height, np.nanmin(drawn.height))
light = LightSource(azdeg=315, altdeg=20).hillshade(
    height, vert_exag=1, dx=drawn.cell, dy=drawn.cell
)
light[~np.isfinite(drawn.height)] = np.nan
axes[0].imshow(light, cmap="gray", extent=extent)
axes[0].set(title="raking light", xlabel="right [cm]", ylabel="up [cm]")

nearest = np.nanmax(drawn.height)
for line in lines:
    axes[1].plot(*(100 * line.points.T), color="0.25", linewidth=0.7)
axes[1].axhline(100 * level, color="C1", linewidth=1)
axes[1].set(title="contours each 5 mm", xlabel="right [cm]", aspect="equal")
axes[1].set(xlim=extent[:2], ylim=extent[2:])

for number in range(int(cut.piece.max()) + 1):
    piece = cut.piece == number
    along = 100 * cut.along[piece]
    axes[2].plot(along, 100 * (cut.height[piece] - nearest), color="C1")
    axes[3].plot(along, 1e3 * cut.uncertainty[piece], color="C1")
    axes[3].plot(along, 1e3 * cut.own[piece], color="0.6")
axes[2].set(title="section", ylabel="height [cm]", aspect="equal")
axes[3].set(
    title="uncertainty of the section; gray: noise alone",
    xlabel="along the section [cm]", ylabel="uncertainty [mm]", ylim=(0, None),
)  # fmt: skip
print(f"median uncertainty of the section {1e3 * np.median(cut.uncertainty):.2f} mm")
plt.show()
