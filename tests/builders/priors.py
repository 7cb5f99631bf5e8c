"""Priors that know the answer, and remember how they were asked."""

from gscomplete.priors.base import Guidance
from recipes.stress_numerics.poisoned_prior import PoisonedPrior


class OraclePrior(PoisonedPrior):
    """Knows one object, asks for guidance of its own and keeps what it was given."""

    guidance_seen: Guidance | None = None

    def default_guidance(self, *, sees_input):
        return Guidance(text_scale=9.0, rescale=0.25)

    def distill(self, views, timestep, conditioning, generator, input_views=None, guidance=None):
        self.guidance_seen = guidance
        return super().distill(views, timestep, conditioning, generator, input_views, guidance)


class GuessingPrior(OraclePrior):
    """Guesses what it was given, if anything."""

    def __init__(self, truth, guess=None):
        super().__init__(truth)
        self.guess = guess

    def first_guess(self, partial, *arguments, **options):
        return self.guess

    def likely_mirrors(self, *arguments):
        return ()
