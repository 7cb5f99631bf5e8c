"""Speed and errors of the CPU renderer, beside the machine's limits and other renderers."""
