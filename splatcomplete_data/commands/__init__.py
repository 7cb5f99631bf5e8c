"""Bodies of the commands: options in, exit code out; the only place that prints."""
