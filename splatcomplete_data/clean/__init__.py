"""Clean splats: what does not belong to the object, rule by rule, each a mask with a count."""
