"""Run the command as ``python -m splatcomplete_data.cli``."""

from splatcomplete_data.cli import run_process

run_process()
