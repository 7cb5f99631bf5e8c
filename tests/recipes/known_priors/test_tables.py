"""Tables of the study."""

from recipes.known_priors.__main__ import table, table_2


def row(error):
    return {
        "silhouette_iou": 0.9, "hidden_iou": 0.8, "hidden_color_psnr_db": None, "fog": 0.0,
        "e_color_v": error, "e_depth_v": 0.0, "calls": 10, "new_splats": 5, "seconds": 1.0,
    }  # fmt: skip


ROWS = {
    "biased/paper/300/0/gso/a": row(0.001),
    "biased/paper/300/0/gso/b": row(0.003),
    "biased/paper/300/1/gso/a": row(0.002),
    "biased/bare/300/0/gso/a": row(0.02),
    "exact/paper/300/0/gso/a": row(0.001),
}


def test_table_2_averages_over_objects_first_and_over_seeds_then():
    lines = table_2(ROWS).splitlines()
    assert lines == [
        "biased, 300 steps, bare: E_color 0.02000 +- 0.00000 over 1 seeds, 10.0 times paper's",
        "biased, 300 steps, paper: E_color 0.00200 +- 0.00000 over 2 seeds, 1.0 times paper's",
    ]


def test_the_table_has_a_line_for_every_prior_way_and_number_of_steps():
    lines = table(ROWS).splitlines()
    assert [line.split()[:4] for line in lines[1:]] == [
        ["biased", "bare", "300", "1"],
        ["biased", "paper", "300", "3"],
        ["exact", "paper", "300", "1"],
    ]
