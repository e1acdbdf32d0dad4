"""From the target signal to range images, point clouds and their quality."""

from amulor.imaging import metrics
from amulor.imaging.point_cloud import point_cloud
from amulor.imaging.range_image import range_image

__all__ = ["metrics", "point_cloud", "range_image"]
