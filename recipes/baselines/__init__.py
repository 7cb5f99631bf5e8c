"""Results of other systems: what each gives, and how it enters our tables."""
