"""
Figures of the paper, redrawn
=============================

This example redraws two figures of Ricci et al. 2010 (:doi:`10.1155/2010/958360`).
Figure 1 shows the depths from which the water signal comes. Figure 3 shows the water as
a low-pass filter. The :doc:`whole study </gallery/ricci2010>` redraws fourteen figures
and tests the statements of the paper.
"""

from io import BytesIO

import matplotlib.pyplot as plt

from amulor.studies.ricci2010 import reproduce
from amulor.view.report import png

# %%
# The option ``quick`` reduces the number of points and photons. The measured data are
# synthetic, because the data of the paper survive only in its pictures.
results = reproduce.run((1, 3), quick=True, depend=False)
for figure in results.figures:
    held = sum(check.passed for check in figure.checks)
    print(f"figure {figure.number}: {held} of {len(figure.checks)} statements hold")
    picture = plt.imread(BytesIO(png(figure.drawn)))
    height, width, _ = picture.shape
    plt.figure(figsize=(8, 8 * height / width)).add_axes((0, 0, 1, 1)).imshow(picture)
    plt.axis("off")
plt.show()
