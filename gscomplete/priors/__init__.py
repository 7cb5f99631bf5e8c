"""Priors: models that know what objects look like, behind one interface (``base``)."""
