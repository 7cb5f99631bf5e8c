"""One self-contained page about completions: pictures, splats to turn, numbers, options."""
