"""Commands and recipes as processes: what is set before PyTorch, and readers that go away."""

import os
import platform
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gscomplete.cli import program
from gscomplete.cli.guard import how_to_go_on, run_guarded
from gscomplete.errors import UserError
from tests.builders.commands import PATIENCE_S, SAMPLE

SPY = """
import importlib.abc, os, sys
class Spy(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == "torch":
            print(os.environ.get("OMP_WAIT_POLICY"), os.environ.get("GOMP_SPINCOUNT"))
            sys.meta_path.remove(self)
        return None
sys.meta_path.insert(0, Spy())
import {module}
import torch
"""


def without_settings() -> dict[str, str]:
    names = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT", "PYTHONUNBUFFERED")
    return {name: value for name, value in os.environ.items() if name not in names}


@pytest.mark.parametrize(
    "module",
    ["gscomplete.cli.program", "splatcomplete_data.cli.program", "recipes.benchmarks.renderer"],
)
def test_threads_are_told_to_sleep_before_the_openmp_runtime_is_loaded(module: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", SPY.format(module=module)],
        env=without_settings(),
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["PASSIVE", "3000"]


@pytest.mark.parametrize(
    "words", [["validate", str(SAMPLE)], ["validate", str(SAMPLE), "--json"], ["--version"]]
)
def test_a_reader_that_has_gone_is_no_error_of_the_file(words: list[str]) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, "-m", "gscomplete.cli", *words],
        env=without_settings(),
        stdout=writing,
        stderr=subprocess.PIPE,
        text=True,
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (141, "")


INTERRUPT = """
import importlib.abc, sys
class Interrupt(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == "{module}":
            raise KeyboardInterrupt
        return None
sys.meta_path.insert(0, Interrupt())
from {package}.cli import main
sys.exit(main(["--help"]))
"""


@pytest.mark.parametrize("package", ["gscomplete", "splatcomplete_data"])
def test_an_interrupt_while_loading_is_one_line(package: str) -> None:
    code = INTERRUPT.format(package=package, module="tyro")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 130
    program = package.replace("splatcomplete_data", "splatcomplete-data")
    assert done.stderr == f"{program}: interrupted; nothing was done\n"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_a_library_is_imported_ends_at_once(number: int, tmp_path: Path) -> None:
    """Libraries that are interrupted in their import swallow it, or abort in native code."""
    swallows = "try:\n    print('importing', flush=True)\n    time.sleep(60)\n"
    swallows += "except BaseException:\n    raise RecursionError\n"
    (tmp_path / "swallows.py").write_text("import time\n" + swallows)
    code = "import sys\nfrom gscomplete.cli.guard import run_guarded\n"
    code += "def work():\n    print('before')\n    import swallows\n"
    code += "sys.exit(run_guarded('mug', work, 'nothing was done'))"
    piped = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    child = subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path, **piped)
    assert child.stdout.readline() == "before\n"
    assert child.stdout.readline() == "importing\n"
    child.send_signal(number)
    _, told = child.communicate(timeout=PATIENCE_S)
    assert child.returncode == 128 + number
    said = "interrupted" if number == signal.SIGINT else "stopped by SIGTERM"
    assert told == f"mug: {said}; nothing was done\n"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_to_end_is_answered_as_an_interrupt(number: int, capsys) -> None:
    # Under nohup the hang-up signal arrives ignored, and stays so.
    started_with = signal.signal(number, signal.SIG_DFL)

    def work() -> int:
        os.kill(os.getpid(), number)
        time.sleep(5)
        return 0

    try:
        assert run_guarded("mug", work, "--resume goes on") == 128 + number
        assert signal.getsignal(number) == signal.SIG_DFL
    finally:
        signal.signal(number, started_with)
    name = signal.Signals(number).name
    assert capsys.readouterr().err == f"mug: stopped by {name}; --resume goes on\n"


def test_a_command_says_how_to_go_on_from_where_it_is(capsys) -> None:
    def work(says: bool) -> int:
        if says:
            how_to_go_on.set("--resume goes on")
        raise KeyboardInterrupt

    assert run_guarded("mug", lambda: run_guarded("mug", lambda: work(True), "no"), "no") == 130
    assert run_guarded("mug", lambda: work(False), "nothing was done") == 130
    assert capsys.readouterr().err.splitlines() == [
        "mug: interrupted; --resume goes on",
        "mug: interrupted; nothing was done",
    ]


def test_a_signal_that_a_library_turns_into_its_own_error_is_still_that_signal(capsys) -> None:
    def swallows(stopped: bool) -> int:
        try:
            if stopped:
                signal.raise_signal(signal.SIGTERM)
        except KeyboardInterrupt as stop:
            raise SystemError("a function returned a result with an exception set") from stop
        raise SystemError("no signal")

    assert run_guarded("tool", lambda: swallows(True), "nothing was written") == 143
    assert capsys.readouterr().err == "tool: stopped by SIGTERM; nothing was written\n"
    assert run_guarded("tool", lambda: swallows(False), "nothing was written") == 70
    assert "internal error: SystemError: no signal" in capsys.readouterr().err


def test_a_signal_that_is_ignored_stays_ignored() -> None:
    """As ``nohup`` asks for."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert run_guarded("mug", lambda: os.kill(os.getpid(), signal.SIGHUP) or 0, "") == 0
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another allocator")
def test_freed_memory_is_kept_for_the_next_request():
    """A large array made again and again is cleared once, not page by page each time."""
    code = (
        "import resource, sys\n"
        "import numpy as np\n"
        "from gscomplete.cli.guard import keep_freed_memory\n"
        "if sys.argv[1] == 'kept': keep_freed_memory()\n"
        "def faults():\n"
        "    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt\n"
        "before = faults()\n"
        "for _ in range(10): [np.ones(3_000_000, np.uint8) for _ in range(8)]\n"
        "print(faults() - before)\n"
    )
    kept, given_back = (
        int(subprocess.check_output([sys.executable, "-c", code, how])) for how in ("kept", "")
    )
    assert kept < 0.3 * given_back


def test_a_process_that_ends_early_has_told_and_tidied_everything() -> None:
    code = (
        "import atexit, sys\n"
        "from gscomplete.cli.guard import run_process\n"
        "atexit.register(print, 'tidied')\n"
        "def main():\n"
        "    sys.stdout.write('told ')\n"
        "    return 3\n"
        "run_process(main)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert (done.returncode, done.stdout, done.stderr) == (3, "told tidied\n", "")


def test_a_process_waits_for_its_threads() -> None:
    code = (
        "import threading, time\n"
        "from gscomplete.cli.guard import run_process\n"
        "def late():\n"
        "    time.sleep(0.3)\n"
        "    print('late', flush=True)\n"
        "run_process(lambda: threading.Thread(target=late).start() or 4)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert (done.returncode, done.stdout) == (4, "late\n")


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_a_closed_stream_ends_no_command(closed: str, tmp_path: Path) -> None:
    """Not even one whose library prints, and no print ends in a file that was opened since."""
    code = (
        "import os, subprocess, sys\n"
        "from gscomplete.cli.guard import run_guarded, run_process\n"
        "def work():\n"
        "    with open('made', 'w') as made:\n"
        "        print('told', flush=True)\n"
        "        print('warned', file=sys.stderr, flush=True)\n"
        "        for number in (1, 2): os.write(number, b'by a library')\n"
        "        subprocess.run(['sh', '-c', 'echo child; echo child >&2'], check=True)\n"
        "        made.write(f'read {sys.stdin.read()!r}')\n"
        "    return 0\n"
        "run_process(lambda: run_guarded('mug', work, ''))\n"
    )
    command = ["sh", "-c", f'"$0" -c "$1" {closed}', sys.executable, code]
    done = subprocess.run(command, cwd=tmp_path, stdin=subprocess.DEVNULL, timeout=PATIENCE_S)
    assert done.returncode == 0
    assert (tmp_path / "made").read_text() == "read ''"


@pytest.mark.parametrize(
    ("encoding", "written"),
    [
        ("utf-8", "\u0447 \u2022 \xe9 ".encode() + b"\xff\n"),
        ("latin-1", b"\\u0447 \\u2022 \xe9 \xff\n"),
        ("ascii", rb"\u0447 \u2022 \xe9 " + b"\xff\n"),
    ],
)
def test_characters_that_a_terminal_lacks_end_no_command(encoding: str, written: bytes) -> None:
    code = (
        "import sys\n"
        "from gscomplete.cli.guard import run_guarded, run_process\n"
        "def work():\n"
        "    for stream in (sys.stdout, sys.stderr):\n"
        "        print('\\u0447 \\u2022 \\xe9 \\udcff', file=stream)\n"
        "    return 0\n"
        "run_process(lambda: run_guarded('mug', work, ''))\n"
    )
    settings = os.environ | {"PYTHONIOENCODING": encoding}
    done = subprocess.run(
        [sys.executable, "-c", code], env=settings, capture_output=True, timeout=PATIENCE_S
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, written, written)


def test_help_texts_are_wrapped_whatever_their_lines_in_the_source(capsys):
    with pytest.raises(SystemExit):
        program.main(["complete", "--help"])
    lines = [line.strip("│ ") for line in capsys.readouterr().out.splitlines()]
    start = lines.index("--view {None}|STR")
    text = lines[start + 1 : lines.index("--range {None}|FLOAT")]
    width = max(len(line) for line in text)
    following = [line.split()[0] for line in text[1:]]
    assert len(text) > 2
    # no line could take the first word of the next one
    for line, word in zip(text[:-1], following, strict=True):
        assert len(line) + 1 + len(word) > width


def test_control_characters_of_a_file_reach_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    def work() -> int:
        raise UserError("a.json: unknown field \x1b[31m\u202e")

    assert run_guarded("mug", work, "") == 2
    assert capsys.readouterr().err == "mug: error: a.json: unknown field \\x1b[31m\\u202e\n"
