"""What the networks of the priors share: in which numbers they run, and convolutions of bytes."""
