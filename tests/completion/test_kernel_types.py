import subprocess
import sys

from gscomplete.completion.kernel_types import COMPILED_BESIDE
from gscomplete.util.kernels import compile_kernels, is_kept

_RUN = """
from gscomplete.completion.kernel_types import COMPILED_BESIDE
from gscomplete.util.kernels import compile_kernels
compile_kernels(COMPILED_BESIDE)
import gscomplete
prior = gscomplete.load_prior("embedded")
gscomplete.complete("recipes/demo/partial.ply", "a mug", prior=prior)
print(*(len(found.kernel.signatures) for found in COMPILED_BESIDE))
"""


def test_a_completion_calls_the_kernels_with_the_types_of_the_table(request):
    """A kernel that is called with other types has a second signature."""
    found = subprocess.run(
        [sys.executable, "-c", _RUN],
        cwd=request.config.rootpath,
        capture_output=True,
        text=True,
        check=True,
    )
    assert found.stdout.split() == ["1"] * len(COMPILED_BESIDE)


def test_kernels_count_as_kept_once_the_disk_has_them():
    compile_kernels(COMPILED_BESIDE)
    assert all(is_kept(found.kernel) for found in COMPILED_BESIDE)
