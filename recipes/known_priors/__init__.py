"""Evaluate score distillation independently of trained weights: priors that know the answer."""
