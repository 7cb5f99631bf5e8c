import math

import numpy as np
import pytest

from gscomplete.errors import UserError
from gscomplete.shape.symmetry import mirror
from recipes.train_embedded_prior.data.findings import Findings, GuessedFrame, read_findings


def test_findings_come_back_from_a_file(tmp_path):
    planes = (mirror(0.3, -0.1, 0.7), mirror(2.9, 0.2, 0.2))
    found = Findings(1234, GuessedFrame((0.1, -0.2, 0.3), 1.25, 40.0), planes)
    np.save(tmp_path / "a.npy", np.stack([found.stored(7), found.stored(9)]))
    np.save(tmp_path / "b.npy", np.stack([found.stored(11)]))
    read = read_findings([tmp_path / "a.npy", tmp_path / "b.npy"])
    assert sorted(read) == [7, 9, 11]
    assert read[9].splats == 1234
    assert read[9].guess == found.guess
    for ours, plane in zip(read[9].planes, planes, strict=True):
        # Half a turn of the normal with the other offset is the same plane.
        np.testing.assert_allclose(ours.matrix, plane.matrix, atol=1e-6)
        np.testing.assert_allclose(ours.shift, plane.shift, atol=1e-6)
        assert math.isclose(ours.score, plane.score, abs_tol=1e-6)


def test_other_files_are_refused(tmp_path):
    (tmp_path / "text.npy").write_text("findings")
    np.save(tmp_path / "other.npy", np.zeros(3))
    for name, reason in (("text", "damage"), ("other", "float64"), ("none", "No such file")):
        with pytest.raises(UserError, match=reason):
            read_findings([tmp_path / f"{name}.npy"])
