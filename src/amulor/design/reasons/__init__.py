"""Why a recommendation is what it is, and whether scans and photons agree with it."""
