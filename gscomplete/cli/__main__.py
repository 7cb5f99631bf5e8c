"""Run the command as ``python -m gscomplete.cli``."""

from gscomplete.cli import run_process

run_process()
