"""Registration: poses of all scans of a site in one frame, with their covariance."""
