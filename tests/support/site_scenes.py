"""The bodies and the scanner of examples/wreck, for tests."""

from __future__ import annotations

from scripts import script

# A script imports those before it.
shapes = script("examples/wreck/bodies.py")
scanning = script("examples/wreck/scanning.py")
make_site = script("examples/wreck/make_site.py")
