"""The input of ``make demo``: a partial object of our own making, stored with its prompt."""
