"""Run the command as ``python -m splatcomplete_data.cli``."""

import sys

from splatcomplete_data.cli import main

sys.exit(main())
