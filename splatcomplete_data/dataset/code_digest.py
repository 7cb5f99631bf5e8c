"""Which code an object was made by: a digest of the modules that its command runs.

Conventions
-----------
* The digest covers the modules of this package and of ``gscomplete`` that a command imports or
  starts as a process (``-m`` and the name), directly or through other modules, inside functions as
  well. So a change to the scan code leaves meshes up to date.
* Comments, docstrings (also of attributes) and layout do not count, as they do not change results.
* Other packages do not count: their versions are a matter of the environment.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import itertools
from pathlib import Path
from typing import Any

import gscomplete
import splatcomplete_data

_ROOTS = {
    package.__name__: Path(package.__path__[0]) for package in (gscomplete, splatcomplete_data)
}


@functools.cache
def code_digest(command: str) -> str:
    """Return the digest of the code behind a command of ``splatcomplete-data``, in hexadecimal."""
    waiting, found = [f"splatcomplete_data.cli.{command}"], dict[str, str]()
    while waiting:
        module = waiting.pop()
        if module in found:
            continue
        found[module], needed = _read(module)
        waiting += needed
    lines = "".join(f"{module} {digest}\n" for module, digest in sorted(found.items()))
    return hashlib.sha256(lines.encode()).hexdigest()


@functools.cache
def _read(module: str) -> tuple[str, tuple[str, ...]]:
    """Return the digest of a module and the modules of ours that it imports or starts."""
    path = _file_of(module)
    assert path is not None
    tree = _WithoutWords().visit(ast.parse(path.read_text(encoding="utf-8")))
    needed = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            needed |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            needed |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.List):
            needed |= _started(node)
    digest = hashlib.sha256(ast.dump(tree).encode()).hexdigest()
    return digest, tuple(sorted(name for name in needed if _file_of(name) is not None))


class _WithoutWords(ast.NodeTransformer):
    """Removes code without effect: strings that are statements, and imports for type checkers."""

    def visit_If(self, node: ast.If) -> Any:
        """Drop the body of ``if TYPE_CHECKING``."""
        self.generic_visit(node)
        is_types = isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
        return node.orelse or None if is_types else node

    def visit_Expr(self, node: ast.Expr) -> Any:
        """Drop a string that is a statement: a docstring of a module, function or attribute."""
        is_text = isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        return None if is_text else self.generic_visit(node)


def _started(command: ast.List) -> set[str]:
    """Return the module that a command line starts as a process, if it starts one."""
    words = [word.value if isinstance(word, ast.Constant) else None for word in command.elts]
    return {str(name) for flag, name in itertools.pairwise(words) if flag == "-m"}


def _file_of(module: str) -> Path | None:
    """Return the file of a module of ours; None = it is none."""
    root, _, rest = module.partition(".")
    if root not in _ROOTS:
        return None
    place = _ROOTS[root].joinpath(*rest.split(".")) if rest else _ROOTS[root]
    for path in (place.with_suffix(".py"), place / "__init__.py"):
        if path.is_file():
            return path
    return None
