"""Score distillation judged apart from its prior: priors that know the answer."""
