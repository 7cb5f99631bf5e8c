"""The house, as a reader walks through it: arrows point one way, and a request is short to follow.

How visits are counted
----------------------
A reader follows ``gscomplete complete`` from function to function and reads each once. The trace
lists the functions in the order of their first call; properties and special methods are read with
their class. The rooms that make the result (cli, completion, framing) are read inside; of the
rooms behind them (priors, shape, preserve) the functions count by which they are entered.
Vocabulary (splats, views, render, util) and tools (fitting, evaluate, folders) count nothing.
Functions in a row of one module are one visit; a visit to a module that was visited before is a
return. What a run says when it has to compile a kernel is not followed: whether and where that
happens depends on the kernels that the disk keeps.
"""

import ast
import contextlib
import functools
import inspect
import sys
from collections import defaultdict
from itertools import groupby
from pathlib import Path

import gscomplete.cli.request
import gscomplete.completion.run_folder
import gscomplete.evaluate
from gscomplete.cli.complete import run
from gscomplete.cli.complete_options import CompleteOptions
from gscomplete.priors import load_prior
from gscomplete.util import kernels
from tests.builders.commands import SAMPLE

ROOT = Path(gscomplete.__file__).parents[1]
READ_INSIDE = ("gscomplete.cli", "gscomplete.completion", "gscomplete.framing")
ENTERED = ("gscomplete.priors", "gscomplete.shape", "gscomplete.completion.preserve")
MOST_VISITS, MOST_RETURNS = 25, 8

LEVELS = (
    ("errors",),
    ("util",),
    ("networks",),
    ("splats",),
    ("views",),
    ("render",),
    ("folders", "fitting", "framing", "shape"),
    ("evaluate", "priors"),
    ("report", "viewer", "completion"),
    ("batch",),
    ("cli",),
)
"""Rooms of the package; one imports only from those before it, never from its own line's others."""


def modules() -> dict[str, Path]:
    """Return all modules of packages and recipes by name."""
    paths = [
        p
        for top in ("gscomplete", "splatcomplete_data", "recipes")
        for p in (ROOT / top).rglob("*.py")
    ]
    names = (".".join(path.relative_to(ROOT).with_suffix("").parts) for path in paths)
    return {name.removesuffix(".__init__"): path for name, path in zip(names, paths, strict=True)}


@functools.cache
def tree_of(path: Path) -> ast.Module:
    """Return a module's syntax tree."""
    return ast.parse(path.read_text(encoding="utf-8"))


@functools.cache
def imports(path: Path) -> set[str]:
    """Return what a module imports, in functions and for type checking too."""
    found = set()
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found


def test_imports_point_one_way():
    """recipes -> splatcomplete_data -> gscomplete, and inside by ``LEVELS``, lazy imports too."""
    level = {room: place for place, rooms in enumerate(LEVELS) for room in rooms}
    upward = []
    for name, path in modules().items():
        package, _, rest = name.partition(".")
        for other in imports(path):
            top, _, inside = other.partition(".")
            if (package, top) in {
                ("gscomplete", "splatcomplete_data"),
                ("gscomplete", "recipes"),
                ("splatcomplete_data", "recipes"),
            }:
                upward.append((name, other))
            elif package == top == "gscomplete":
                here, there = rest.split(".")[0], inside.split(".")[0]
                if (
                    here in level
                    and there in level
                    and here != there
                    and level[there] >= level[here]
                ):
                    upward.append((name, other))
    assert not upward


def test_there_is_no_cycle_of_imports():
    """Imports in functions and for type checking among them; a package's face is no cycle."""
    known = modules()
    faces = {name for name, path in known.items() if path.name == "__init__.py"}
    edges = {name: imports(path) & set(known) - faces - {name} for name, path in known.items()}
    done: set[str] = set()

    def walk(name: str, above: tuple[str, ...]) -> None:
        assert name not in above, f"cycle: {' -> '.join([*above[above.index(name) :], name])}"
        if name not in done:
            for other in edges[name]:
                walk(other, (*above, name))
            done.add(name)

    for name in known:
        walk(name, ())


def test_every_folder_says_what_it_holds():
    """In one sentence; what more there is to say stands below it."""
    for name, path in modules().items():
        if path.name == "__init__.py":
            text = ast.get_docstring(tree_of(path)) or ""
            sentence = text.split("\n\n")[0]
            assert len(sentence) > 20, f"{name}: {sentence!r}"
            assert sentence.endswith("."), f"{name}: {sentence!r}"


def test_no_folder_is_crowded():
    folders = defaultdict(list)
    for path in modules().values():
        folders[path.parent].append(path.name)
    crowded = {str(folder): len(names) for folder, names in folders.items() if len(names) > 16}
    assert len(folders[ROOT / "gscomplete" / "completion"]) <= 13, "a dozen and __init__"
    assert not crowded


def followed_functions(tmp_path: Path, monkeypatch) -> list[tuple[str, str]]:
    """Complete an object; return module and name of every function on the path as it is entered."""
    monkeypatch.setattr(kernels, "compilations_told", lambda _: contextlib.nullcontext())
    names = {str(path): name for name, path in modules().items()}
    seen, path = set(), []

    def listen(frame, event, _):
        code = frame.f_code
        module = names.get(code.co_filename)
        if event != "call" or module is None or code in seen:
            return
        seen.add(code)
        special = code.co_name.startswith(("__", "<")) or not code.co_flags & inspect.CO_NEWLOCALS
        caller = frame.f_back
        while caller is not None and caller.f_code.co_filename not in names:
            caller = caller.f_back
        if special or is_property(frame) or (caller is None and path):
            return
        came_from = names[caller.f_code.co_filename] if caller else ""
        room = next((room for room in ENTERED if module.startswith(room)), None)
        if (room is not None and not came_from.startswith(room)) or (
            room is None and module.startswith(READ_INSIDE)
        ):
            path.append((module, code.co_name))

    load_prior("embedded")  # modules that load on the way are no part of it
    options = CompleteOptions(partial=SAMPLE, prompt="a toy", out=tmp_path / "run", device="cpu")
    sys.setprofile(listen)
    try:
        run(options)
    finally:
        sys.setprofile(None)
    return path


def is_property(frame) -> bool:
    """Whether a frame is that of a property of its first argument."""
    code = frame.f_code
    if not code.co_argcount:
        return False
    owner = frame.f_locals.get(code.co_varnames[0])
    return isinstance(inspect.getattr_static(type(owner), code.co_name, None), property)


def test_a_request_is_short_to_follow(tmp_path, monkeypatch):
    """The default, from the command to the files of the run folder."""
    path = followed_functions(tmp_path, monkeypatch)
    visits = [module for module, _ in groupby(path, key=lambda step: step[0])]
    returns = len(visits) - len(set(visits))
    walk = "\n".join(visits)
    assert "gscomplete.shape.guess" in visits, walk
    assert len(visits) <= MOST_VISITS, walk
    assert returns <= MOST_RETURNS, walk
