"""Run the command as ``python -m gscomplete.cli``."""

import sys

from gscomplete.cli import main

sys.exit(main())
