"""Joint method: maximum-likelihood estimation of target and water signal."""
