"""Small measured and simulated data that come with the package."""

from amulor.samples.listing import Sample, copy, cube, sample, samples

__all__ = ["Sample", "copy", "cube", "sample", "samples"]
