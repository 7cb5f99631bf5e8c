import subprocess
import sys
from pathlib import Path

import pytest

from gscomplete.errors import UserError
from gscomplete.util.folder_lock import lock_folder

HOLD = """
import sys, time
from pathlib import Path
from gscomplete.util.folder_lock import lock_folder
lock = lock_folder(Path(sys.argv[1]))
print("held", flush=True)
time.sleep(60)
"""


def test_a_folder_is_one_processs_at_a_time_and_free_when_that_is_killed(tmp_path: Path) -> None:
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with pytest.raises(UserError, match="another process is at work in this folder"):
            lock_folder(tmp_path)
        other.kill()
    assert lock_folder(tmp_path) is not None
    assert list(tmp_path.iterdir()) == []


def test_within_a_process_a_lock_is_shared(tmp_path: Path) -> None:
    first = lock_folder(tmp_path)
    assert lock_folder(tmp_path) is first
