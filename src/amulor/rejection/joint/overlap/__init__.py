"""How receiver and light overlap: geometry, tables and integrals of a scan."""
