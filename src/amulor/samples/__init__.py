"""Sample data that come with the package, measured and simulated."""

from amulor.samples.listing import Sample, copy, cube, sample, samples

__all__ = ["Sample", "copy", "cube", "sample", "samples"]
