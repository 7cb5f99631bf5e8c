"""Read YAML whose aliases are harmless: none stands for itself, and together they name little.

Conventions
-----------
* An alias (``*name``) repeats what its anchor (``&name``) marks, merge keys (``<<``) too. A few
  lines of aliases of aliases can stand for billions of values.
* The nodes are counted before anything is made of them, as if each alias were written out.
* A mapping has each key once; YAML's own reader would take the last of its values.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gscomplete.errors import UserError
from gscomplete.util.optional import import_optional

_MOST_REPEATED = 100_000
"""Values that aliases may add to those of the file."""
_LONGEST_KEY = 40
"""In messages, characters."""


def read_yaml(path: Path, purpose: str) -> Any:
    """Read a YAML file as plain values.

    Args:
        path: the file.
        purpose: what it is read for, in the message that PyYAML is missing.

    Raises:
        UserError: it is missing, no YAML, a key is there twice, or an alias stands for itself or
            for too much.
    """
    yaml = import_optional("yaml", purpose)
    try:
        text = path.read_text(encoding="utf-8")
        loader = yaml.SafeLoader(text)
        try:
            root = loader.get_single_node()
            if root is None:
                return None
            _check_nodes(path, root, len(text) + _MOST_REPEATED)
            return loader.construct_document(root)
        finally:
            loader.dispose()
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: cannot read it ({error})") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise UserError(f"{path}: expected YAML ({error})") from error


def _check_nodes(path: Path, root: Any, most: int) -> None:
    """Check keys, that no node holds itself, and that none stands for more than ``most`` nodes.

    Raises:
        UserError: one does; the message names the field and its line.
    """
    sizes: dict[int, int] = {}
    """By the identity of a node: how many nodes it stands for."""
    above: set[int] = set()

    def refusal(node: Any, where: str, found: str) -> UserError:
        line = node.start_mark.line + 1
        return UserError(f"{path}: {where or 'the top level'} (line {line}): {found}")

    def size_of(node: Any, where: str) -> int:
        if id(node) in above:
            raise refusal(node, where, "expected a value, found an alias of a value that holds it")
        if id(node) not in sizes:
            above.add(id(node))
            total = 1
            for inner, name in _children(node):
                total += size_of(inner, f"{where}{name}" if where else name.removeprefix("."))
                if total > most:
                    found = f"expected at most {most:,} values, found aliases that stand for more"
                    raise refusal(node, where, found)
            again = _repeated_key(node)
            if again is not None:
                found = f"expected every key once, found {_shown(again)!r} again"
                raise refusal(again, where, found)
            above.remove(id(node))
            sizes[id(node)] = total
        return sizes[id(node)]

    size_of(root, "")


def _children(node: Any) -> list[tuple[Any, str]]:
    """Return a node's keys and values, or its items, with how a message appends their names."""
    if node.id == "mapping":
        pairs = [(key, value, f".{_shown(key)}") for key, value in node.value]
        return [(inner, name) for key, value, name in pairs for inner in (key, value)]
    if node.id == "sequence":
        return [(item, f"[{index}]") for index, item in enumerate(node.value)]
    return []


def _repeated_key(node: Any) -> Any:
    """Return the first key of a mapping that is there a second time; None = there is none."""
    seen: set[tuple[str, str]] = set()
    for key, _ in node.value if node.id == "mapping" else ():
        if key.id == "scalar":
            if (key.tag, key.value) in seen:
                return key
            seen.add((key.tag, key.value))
    return None


def _shown(key: Any) -> str:
    """Return a mapping's key as a message shows it."""
    return " ".join(key.value.split())[:_LONGEST_KEY] if key.id == "scalar" else "?"
