"""The digest of a command's code changes with what it runs, and with nothing else."""

from collections.abc import Callable
from pathlib import Path

import pytest

from splatcomplete_data.dataset import code_digest as module

CODE = {
    "gscomplete/__init__.py": "",
    "gscomplete/other.py": "x = 1",
    "splatcomplete_data/__init__.py": "",
    "splatcomplete_data/cli/__init__.py": "",
    "splatcomplete_data/cli/mesh.py": "def run():\n    from splatcomplete_data import near\n",
    "splatcomplete_data/cli/scan.py": "import gscomplete.other",
    "splatcomplete_data/near.py": "def f():\n    return 1\n",
}


@pytest.fixture
def digest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """Digests of the code above, a file of it changed."""
    roots = {name: tmp_path / name for name in ("gscomplete", "splatcomplete_data")}
    monkeypatch.setattr(module, "_ROOTS", roots)

    def after(command: str, file: str = "gscomplete/__init__.py", text: str = "") -> str:
        for name, code in {**CODE, file: text}.items():
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_text(code)
        module.code_digest.cache_clear()
        module._read.cache_clear()
        return module.code_digest(command)

    yield after
    module.code_digest.cache_clear()
    module._read.cache_clear()


def test_what_a_command_runs_counts_however_far(digest):
    before = digest("mesh")
    assert digest("mesh", "splatcomplete_data/near.py", "def f():\n    return 2\n") != before
    assert digest("mesh", "splatcomplete_data/cli/mesh.py", "def run(): ...") != before
    assert digest("scan", "gscomplete/other.py", "x = 2") != digest("scan")
    assert digest("mesh") == before


def test_words_layout_types_and_the_code_of_others_do_not(digest):
    before = digest("mesh")
    worded = 'def f():\n    """One."""\n\n    return 1  # yes\n'
    assert digest("mesh", "splatcomplete_data/near.py", worded) == before
    assert digest("mesh", "gscomplete/other.py", "x = 2") == before
    typed = CODE["splatcomplete_data/near.py"] + "if TYPE_CHECKING:\n    import gscomplete.other\n"
    assert digest("mesh", "splatcomplete_data/near.py", typed) == before


def test_texts_beside_attributes_do_not_count(digest):
    code = "class A:\n    x: int = 1\n"
    before = digest("mesh", "splatcomplete_data/near.py", code)
    worded = code + '    """One."""\n'
    assert digest("mesh", "splatcomplete_data/near.py", worded) == before


def test_modules_that_are_started_by_name_count(digest, monkeypatch):
    starts = 'import sys\n\n\ndef f():\n    return [sys.executable, "-m", "gscomplete.other"]\n'
    monkeypatch.setitem(CODE, "splatcomplete_data/near.py", starts)
    assert digest("mesh", "gscomplete/other.py", "x = 2") != digest("mesh")


def test_the_commands_of_this_package_have_digests_of_their_own():
    digests = {name: module.code_digest(name) for name in ("mesh", "scan", "depth", "images")}
    assert len(set(digests.values())) == len(digests)
