"""Merged point cloud of all scans, with the covariance of each point."""
