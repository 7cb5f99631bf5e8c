"""What runs leave behind: run.json, a checkpoint, a log, the ledger of a batch."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path


def run_seeds(folder: Path) -> list[tuple[str, Callable[[Path], object]]]:
    """Write the files; return each with its reader."""
    import torch
    from safetensors.torch import save_file

    from gscomplete.batch.ledger import read_ledger
    from gscomplete.fitting.checkpoint import FILE_NAME, check_fits, load_checkpoint
    from gscomplete.fitting.step_loop import require_same_identity
    from gscomplete.folders import RUN_FILE, read_run_folder
    from gscomplete.util.jsonio import write_json
    from gscomplete.util.versions import differences_note
    from gscomplete.views import ObjectFrame, ViewDistribution

    identity = {
        "prompt": "a mug",
        "frame": ObjectFrame("Z", (0.0, 0.0, 0.0), 1.0).to_json(),
        "views": ViewDistribution(0.0, 10.0).to_json(),
        "settings": {"seed": 0},
    }
    run = {"schema": "gscomplete.run", "input": {"path": "p.ply", "splats": 3}}
    run |= {"identity": identity, "made_with": {"torch": "2.13.0", "numpy": "2.4.6"}}
    write_json(folder / RUN_FILE, run)
    fresh = {"step": torch.tensor(0), "value.means": torch.zeros(4, 3)}
    state = {**fresh, "step": torch.tensor(3), "adam.means.step": torch.tensor(3.0)}
    state |= {f"adam.means.{key}": torch.ones(4, 3) for key in ("exp_avg", "exp_avg_sq")}
    save_file(state, folder / FILE_NAME)
    rows = [{"id": name, "status": "finished", "inputs": [[1, 2.0]], "facts": {}} for name in "ab"]
    (folder / "ledger.jsonl").write_text("\n".join(map(json.dumps, rows)) + "\n")

    def checkpoint(path: Path) -> object:
        found = load_checkpoint(path.parent)
        if found is not None:
            check_fits(path, found, fresh, 5)
        return found

    def resume(path: Path) -> None:
        read_run_folder(path.parent)
        require_same_identity(path, identity)
        differences_note(json.loads(path.read_text()).get("made_with"))

    return [(RUN_FILE, resume), (FILE_NAME, checkpoint), ("ledger.jsonl", read_ledger)]
