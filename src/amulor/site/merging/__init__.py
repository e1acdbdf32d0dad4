"""One cloud of all scans, with the covariance of each point, and its files."""
