"""Benchmark of the rejection methods on public scenes with known ranges."""
