"""
Figures of the paper, redrawn
=============================

Figures 1 and 3 of Ricci et al. 2010 (:doi:`10.1155/2010/958360`): the depths that the
water signal comes from, and the water as a low-pass. The :doc:`whole study
</gallery/ricci2010>` redraws all figures and tests the statements of the paper.
"""

from io import BytesIO

import matplotlib.pyplot as plt

from amulor.studies.ricci2010 import reproduce
from amulor.view.report import png

# %%
# ``quick`` computes fewer points and photons. The measured data are synthetic, because
# those of the paper survive only in its pictures.
results = reproduce.run((1, 3), quick=True, depend=False)
for figure in results.figures:
    held = sum(check.passed for check in figure.checks)
    print(f"figure {figure.number}: {held} of {len(figure.checks)} statements hold")
    picture = plt.imread(BytesIO(png(figure.drawn)))
    height, width, _ = picture.shape
    plt.figure(figsize=(8, 8 * height / width)).add_axes((0, 0, 1, 1)).imshow(picture)
    plt.axis("off")
plt.show()
