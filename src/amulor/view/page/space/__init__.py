"""Point clouds and meshes as the page shows them: read, thinned, told in words."""

from amulor.view.page.space.opening import ENDINGS, is_space, opened
from amulor.view.page.space.shown import Space

__all__ = ["ENDINGS", "Space", "is_space", "opened"]
