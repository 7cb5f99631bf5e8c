import shutil
from typing import ClassVar

import pytest
import torch

from gscomplete.errors import UserError
from gscomplete.priors.embedded.text import NO_TEXT_TOKEN
from gscomplete.shape.network import ShapeOutput
from gscomplete.util.jsonio import read_json
from recipes.train_embedded_prior import compare_shapes
from recipes.train_embedded_prior.compare_shapes import Options, load_network, part_ious
from recipes.train_embedded_prior.data.shape_dataset import ShapeBatch
from recipes.train_embedded_prior.shape_task import ShapeTask
from recipes.train_embedded_prior.state import TrainState, open_run
from recipes.train_embedded_prior.views_task import ViewsTask
from tests.builders.mesh_pack import write_pack
from tests.builders.training import WORDS, stub_source, tiny_run, tiny_shape_run


def run_folder(folder, seed):
    config = tiny_shape_run(folder, seed=seed)
    open_run(config, WORDS)
    TrainState.start(config, ShapeTask(config, stub_source, WORDS).make_model).save(folder)
    return folder


def test_networks_are_asked_about_the_same_parts(tmp_path, capsys):
    pack, out = write_pack(tmp_path / "pack"), tmp_path / "out"
    one, other = run_folder(tmp_path / "one", 1), run_folder(tmp_path / "other", 2)
    again = shutil.copytree(one, tmp_path / "again")
    networks = (one, again, other)
    compare_shapes.main(Options(pack, out, networks, parts=2, orientations=2))
    assert len(list(out.glob("parts-2-*.npy"))) == 1
    rows = read_json(out / "compared.json")
    assert rows[str(one)] == rows[str(again)]
    assert all(0.0 <= iou <= 1.0 for iou in rows[str(other)])
    lines = capsys.readouterr().out.splitlines()
    assert "+0.0000 (+0.0000 to +0.0000)  n = 2" in lines[1]


def test_overlaps_are_those_of_filled_cells():
    class Half(torch.nn.Module):
        """Fills the lower half, whichever way the object is turned about z."""

        told: ClassVar[list[int]] = []

        def forward(self, volumes, evidence, scores, tokens):
            self.told.append(int(tokens[0, 0]))
            filled = torch.full((1, 4, 4, 4), -1.0)
            filled[..., :2] = 1.0
            zeros = torch.zeros(1, 3, 2, 2, 2)
            return ShapeOutput(filled, zeros, zeros)

    solid = torch.zeros(2, 4, 4, 4)
    solid[0, ..., :2], solid[1, ..., 1:] = 1.0, 1.0
    nothing = torch.zeros(2, 1, 4, 4, 4)
    batch = ShapeBatch(nothing, nothing, torch.zeros(2, 1), torch.zeros(2, 1), solid, nothing)
    assert part_ious(Half(), batch, 8) == pytest.approx([1.0, 0.25])
    assert Half.told == [0, NO_TEXT_TOKEN] * 8


def test_a_run_of_the_denoiser_is_refused(tmp_path):
    config = tiny_run(tmp_path)
    open_run(config, WORDS)
    TrainState.start(config, ViewsTask(config, stub_source, WORDS).make_model).save(tmp_path)
    with pytest.raises(UserError, match="expected a run of the shape network"):
        load_network(tmp_path)
