"""Who imports whom in this tree, read from the source.

Imports within a function are late. Those under TYPE_CHECKING never run.
"""

import ast
import dataclasses
import functools
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
HOUSES = ("medjax", "train", "benchmarks")


@dataclasses.dataclass(frozen=True)
class Import:
    """An import of one module."""

    target: str
    line: int
    is_late: bool
    is_for_types: bool


@dataclasses.dataclass(frozen=True)
class Module:
    """A module or an `__init__` of our packages."""

    name: str
    path: Path
    tree: ast.Module

    @property
    def is_command(self):
        """Whether it has a `main` or is a `__main__`."""
        return self.name.endswith("__main__") or "main" in self.defined

    @property
    def stands_for_another(self):
        """Whether it only runs the command that it imports."""
        return not self.defined and any("__main__" in ast.dump(node) for node in self.tree.body)

    @property
    def defined(self):
        """Names of its functions and classes."""
        kinds = ast.FunctionDef | ast.ClassDef
        return {node.name for node in self.tree.body if isinstance(node, kinds)}


def source_files(*folders, endings=("py",)):
    """Files under folders of the tree."""
    found = (path for folder in folders for path in sorted((ROOT / folder).rglob("*")))
    return [path for path in found if path.suffix[1:] in endings and path.is_file()]


@functools.cache
def modules():
    """All modules of our packages by dotted name."""
    found = {}
    for path in source_files(*HOUSES):
        parts = path.relative_to(ROOT).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        found[name] = Module(name, path, ast.parse(path.read_text(encoding="utf-8")))
    return found


@functools.cache
def imports_of(name):
    """Imports of a module, of other packages too."""
    return tuple(imports_in(modules()[name].tree, False, False))


def imports_in(node, is_late, is_for_types) -> Iterator[Import]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import):
            for alias in child.names:
                yield Import(alias.name, child.lineno, is_late, is_for_types)
        elif isinstance(child, ast.ImportFrom):
            assert not child.level, "imports are absolute"
            whole = {f"{child.module}.{alias.name}" for alias in child.names} & modules().keys()
            rest = {child.module} if len(whole) < len(child.names) else set()
            for target in sorted(whole | rest):
                yield Import(target, child.lineno, is_late, is_for_types)
        else:
            late = is_late or isinstance(child, ast.FunctionDef | ast.Lambda)
            typed = isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test)
            yield from imports_in(child, late, is_for_types or typed)


def arrows():
    """(module, Import) of all imports among our packages."""
    return [
        (name, found)
        for name in modules()
        for found in imports_of(name)
        if found.target in modules()
    ]


def graph_of(found_arrows):
    """The modules that each module imports."""
    graph = {name: set() for name in modules()}
    for name, found in found_arrows:
        graph[name].add(found.target)
    return graph


def way(graph, start, is_end):
    """A shortest path along imports from `start` to a module that is an end; None if there is none."""
    ways, seen = [[start]], set()
    for path in ways:
        for target in sorted(graph[path[-1]] - seen):
            if is_end(target):
                return [*path, target]
            seen.add(target)
            ways.append([*path, target])
    return None
