"""Recipes: scripts that train, benchmark and check what the packages ship."""

from gscomplete.cli.guard import let_threads_sleep

let_threads_sleep()  # recipes are programs, and most of them load PyTorch
