"""`python -m amulor` is the command `amulor`."""

import sys

from amulor.cli import main

sys.exit(main())
