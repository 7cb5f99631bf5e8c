import dataclasses

import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.priors import FourViews, Guidance, Prior, load_prior
from gscomplete.priors.base import prior_identity
from gscomplete.priors.embedded.prior import EmbeddedPrior
from gscomplete.priors.embedded.weights import save_weights
from gscomplete.shape.mirror_plane import MirrorPlane
from gscomplete.views import ViewDistribution
from tests.builders.objects import ball, half
from tests.builders.tiny_denoiser import ring_views, tiny_config, tiny_model


@pytest.fixture(scope="module")
def prior():
    return EmbeddedPrior(tiny_model(), tiny_config(), precision="float32")


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def test_it_is_a_prior(prior):
    checked: Prior = prior
    assert checked.sees_input
    assert checked.num_timesteps == 1000
    low, high = checked.views.radius_range()
    assert 1.8 < low < high < 2.7


def test_distill_gradient_is_the_residual_and_stops_at_the_target(prior):
    size = prior.views.resolution_px
    views = ring_views(size)
    color = views.color.clone().requires_grad_()
    alpha = views.alpha.clone().requires_grad_()
    moved = dataclasses.replace(views, color=color, alpha=alpha)
    loss = prior.distill(moved, 500.0, prior.condition("a red mug"), generator())
    loss.backward()
    # d/dx of 0.5 * sum((2x - 1 - target)^2) / 4 is (2x - 1 - target) / 2
    residual = torch.cat([color.grad, alpha.grad[..., None]], -1) * 2
    assert float(0.5 * residual.square().sum() / 4) == pytest.approx(loss.item(), rel=1e-4)


def test_distill_is_differentiable_at_other_sizes(prior):
    views = ring_views(40)
    color = views.color.clone().requires_grad_()
    prior.distill(
        dataclasses.replace(views, color=color), 300.5, prior.condition("chair"), generator()
    ).backward()
    assert (color.grad != 0).float().mean() > 0.99


def test_same_generator_same_numbers(prior):
    views, words = ring_views(), prior.condition("red mug")
    first = prior.distill(views, 700, words, generator(3), views)
    assert torch.equal(first, prior.distill(views, 700, words, generator(3), views))
    assert not torch.equal(first, prior.distill(views, 700, words, generator(4), views))


def test_seeing_the_input_matters_and_its_absence_is_text_only(prior):
    views, words = ring_views(), prior.condition("red mug")
    guidance = Guidance()
    blind = prior.distill(views, 700, words, generator(), None, guidance)
    seeing = prior.distill(views, 700, words, generator(), ring_views(seed=5), guidance)
    assert not torch.isclose(blind, seeing)
    nothing = FourViews(
        torch.zeros(4, 32, 32, 3), torch.zeros(4, 32, 32), torch.zeros(4, 32, 32), views.cameras
    )
    empty = prior.distill(views, 700, words, generator(), nothing, guidance)
    torch.testing.assert_close(blind, empty)


def test_a_prompt_not_understood_is_no_prompt(prior):
    views = ring_views()
    unknown, empty = prior.condition("qwerty"), prior.condition("")
    assert "qwerty" in " ".join(unknown.report)
    strong = Guidance(text_scale=7.0)
    torch.testing.assert_close(
        prior.distill(views, 400, unknown, generator(), None, strong),
        prior.distill(views, 400, empty, generator(), None, strong),
    )


def test_negative_prompt_takes_the_place_of_no_text(prior):
    views, guidance = ring_views(), Guidance(text_scale=3.0)
    plain = prior.distill(views, 600, prior.condition("red mug"), generator(), None, guidance)
    away = prior.condition("red mug", "blue chair")
    assert any("negative" in line for line in away.report)
    assert not torch.isclose(plain, prior.distill(views, 600, away, generator(), None, guidance))


@pytest.mark.parametrize("timestep", [999, 5000, 350.25])
def test_reconstruct_gives_valid_images_without_graph(prior, timestep):
    views = ring_views()
    views = dataclasses.replace(views, color=views.color.requires_grad_())
    color, alpha = prior.reconstruct(
        views, timestep, prior.condition("mug"), generator(), views, num_steps=3
    )
    size = prior.views.resolution_px
    assert color.shape == (4, size, size, 3)
    assert alpha.shape == (4, size, size)
    assert not color.requires_grad
    assert ((color >= 0) & (color <= alpha[..., None]) & (alpha[..., None] <= 1)).all()


def test_reconstruct_from_pure_noise_sees_only_the_cameras(prior):
    words = prior.condition("mug")
    first = prior.reconstruct(ring_views(seed=1), 999, words, generator(), num_steps=2)
    second = prior.reconstruct(ring_views(seed=2), 999, words, generator(), num_steps=2)
    torch.testing.assert_close(first, second)


def test_yaw_of_the_ring_does_not_matter_but_elevation_does(prior):
    words = prior.condition("mug")
    flat, steep = ring_views(elevation_deg=0.0), ring_views(elevation_deg=40.0)
    first = prior.distill(flat, 600, words, generator())
    turned = ring_views(elevation_deg=0.0, azimuth_deg=-200.0)
    torch.testing.assert_close(first, prior.distill(turned, 600, words, generator()))
    assert not torch.isclose(first, prior.distill(steep, 600, words, generator()))


@pytest.mark.parametrize("timestep", [-1, 1000, float("nan")])
def test_timesteps_out_of_range_are_refused(prior, timestep):
    with pytest.raises(ValueError, match="timestep"):
        prior.distill(ring_views(), timestep, prior.condition(""), generator())


def test_another_priors_conditioning_is_refused(prior):
    class Other:
        report = ()

    with pytest.raises(TypeError, match="Other"):
        prior.distill(ring_views(), 5, Other(), generator())


def test_unknown_prior_and_empty_folder_are_user_errors(tmp_path):
    with pytest.raises(UserError, match="expected embedded"):
        load_prior("no-such-prior")
    with pytest.raises(UserError, match="found none of them"):
        load_prior(str(tmp_path))


def test_weights_from_a_folder(tmp_path, prior):
    save_weights(tmp_path, tiny_model().state_dict(), tiny_config())
    loaded = load_prior(str(tmp_path))
    assert loaded.views == prior.views
    words = loaded.condition("a red mug")
    assert words.report == prior.condition("a red mug").report
    assert torch.isfinite(loaded.distill(ring_views(), 500, words, generator()))


def test_views_of_wrong_shape_are_refused():
    views = ring_views()
    with pytest.raises(ValueError, match="color: expected"):
        dataclasses.replace(views, color=views.color[:, :-1])


def test_other_weights_are_another_prior(tmp_path):
    identities = []
    for name, scale in (("a", 1.0), ("b", 1.0), ("c", 1.01)):
        state = {key: scale * value for key, value in tiny_model().state_dict().items()}
        save_weights(tmp_path / name, state, tiny_config())
        identities.append(prior_identity(load_prior(str(tmp_path / name))))
    assert identities[0] == identities[1]
    assert identities[0] != identities[2]
    assert identities[0]["name"] == "embedded"


def test_the_shape_network_runs_in_the_precision_of_the_cpu(monkeypatch):
    """Wherever the denoiser is: emulated bfloat16 is many times slower than float32."""
    answers = {"cpu": False, "meta": True}
    monkeypatch.setattr(
        "gscomplete.networks.precision.multiplies_bfloat16",
        lambda device: answers[device.type],
    )
    prior = EmbeddedPrior(tiny_model(), tiny_config(), "meta")
    assert prior._bfloat16
    assert not prior._shape_bfloat16


def test_a_part_that_ends_squarely_at_a_plane_is_mirrored_through_it():
    prior = load_prior("embedded")
    views, conditioning = ViewDistribution(180.0, 10.0), prior.condition("a ball")
    part = half(ball(4000))
    guess = prior.first_guess(part, views, conditioning, generator(), 2000)
    assert "squarely" in guess.notes[0]
    mirrored = part.means * torch.tensor([-1.0, 1.0, 1.0])
    nearest = torch.cdist(mirrored[::20], guess.splats.means).amin(dim=1)
    assert float(nearest.quantile(0.9)) < 0.03
    asked = prior.first_guess(part, views, conditioning, generator(), 2000, "none")
    assert not any("squarely" in note for note in asked.notes)


def test_the_image_in_a_square_cut_is_all_that_is_added():
    prior, part = load_prior("embedded"), half(ball(4000))
    views, conditioning = ViewDistribution(0.0, 10.0), prior.condition("a ball")
    guess = prior.first_guess(part, views, conditioning, generator(), 2000)
    assert 0.9 * len(part) <= len(guess.splats) <= len(part)
    away = torch.cdist(guess.splats.means, part.means * torch.tensor([-1.0, 1.0, 1.0]))
    assert float(away.amin(dim=1).max()) < 0.04
    # Through a plane that users choose the network's surface counts, too.
    plane = MirrorPlane(0.0, 0.0)
    chosen = prior.first_guess(part, views, conditioning, generator(), 2000, plane)
    assert len(chosen.splats) > len(guess.splats)


def test_where_the_image_would_hide_p_the_networks_surface_counts():
    prior, part = load_prior("embedded"), half(ball(4000))
    from_open_side = ViewDistribution(180.0, 10.0)
    guess = prior.first_guess(part, from_open_side, prior.condition("a ball"), generator(), 2000)
    assert len(guess.splats) > 1000


def test_what_the_prompt_changes_is_told_against_no_prompt_whatever_the_negative_one():
    prior, part = load_prior("embedded"), half(ball(1000))
    told = []
    for negative in (None, "a chair"):
        conditioning = prior.condition("a ball", negative)
        guess = prior.first_guess(part, ViewDistribution(0, 10), conditioning, generator(), 500)
        told.append([note for note in guess.notes if note.startswith("prompt: ")])
    assert len(told[0]) == 1
    assert told[0] == told[1]


def test_nothing_is_added_to_a_closed_surface_unless_asked():
    prior = load_prior("embedded")
    views, conditioning = ViewDistribution(0.0, 10.0), prior.condition("a ball")
    complete = ball(2000)
    closed = prior.first_guess(complete, views, conditioning, generator(), 500)
    assert len(closed.splats) == 0
    assert "complete" in closed.notes[0]
    assert (
        len(prior.first_guess(half(complete), views, conditioning, generator(), 500).splats) > 100
    )
    asked = prior.first_guess(complete, views, conditioning, generator(), 500, "none")
    assert "complete" not in asked.notes[0]


@pytest.mark.parametrize(("prompt", "grows"), [("a unicorn", False), ("a lamp", True)])
def test_a_closed_surface_is_part_of_more_only_by_a_known_shape(prompt, grows):
    """Where no shape is known, a prompt that decides decides nothing."""
    prior = load_prior("embedded")
    views, conditioning = ViewDistribution(0.0, 10.0), prior.condition(prompt)
    guess = prior.first_guess(
        ball(2000), views, conditioning, generator(), 500, prompt_decides=True
    )
    assert (len(guess.splats) > 0) == grows
    assert "known shape" in guess.notes[0]
    assert ("complete" in guess.notes[-1]) != grows
