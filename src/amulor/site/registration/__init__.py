"""Poses of all scans of a site in one frame, with a covariance that holds."""
