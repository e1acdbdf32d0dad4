"""`python -m amulor`, which runs the command `amulor`."""

import sys

from amulor.cli import main

sys.exit(main())
