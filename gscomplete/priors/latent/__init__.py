"""What latent diffusion priors share: networks and files, codec, prompts, guidance, settings."""
