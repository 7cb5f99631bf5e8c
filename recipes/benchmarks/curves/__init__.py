"""Curves of time against error: charts, and the page of all of them."""
