"""What changed between two visits, how sure that is, and what moved whereto."""
