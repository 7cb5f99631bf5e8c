"""What latent diffusion priors share: codec, prompt encoder, guidance, distillation, settings."""
