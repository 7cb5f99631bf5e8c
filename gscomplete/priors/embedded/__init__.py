"""The prior that ships with the package: a small four-view denoiser in pixel space."""
