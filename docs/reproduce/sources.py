"""Which files what a command prints depends on: the modules that it imports, those that these import, and so on."""

from __future__ import annotations

import ast
import functools
import hashlib
from collections.abc import Iterable
from pathlib import Path

from docs.reproduce.pages import OURS, ROOT

READ = (".js", ".css", ".html", ".json", ".zip")  # files that a module reads of its own folders


@functools.cache
def _path(module: str) -> Path | None:
    """The file of a module of ours, or None."""
    path = ROOT / module.replace(".", "/")
    found = (path.with_suffix(".py"), path / "__init__.py")
    return next((path for path in found if path.is_file()), None)


@functools.cache
def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@functools.cache
def _read_by(path: Path) -> frozenset[Path]:
    """What is in the folders beside a module that it names."""
    nodes = ast.walk(_tree(path))
    words = {node.value for node in nodes if isinstance(node, ast.Constant) and node.value}
    folders = [folder for folder in path.parent.iterdir() if folder.is_dir()]
    named = [folder for folder in folders if folder.name in words]
    return frozenset(file for folder in named for file in folder.rglob("*") if file.suffix in READ)


@functools.cache
def _imported(module: str) -> frozenset[str]:
    """What a module of ours imports of ours, at any place, and the packages that it is in."""
    path = _path(module)
    if path is None:
        return frozenset()
    parts = module.split(".")
    names = {".".join(parts[:count]) for count in range(1, len(parts))}
    for node in ast.walk(_tree(path)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return frozenset(
        name for name in names if name.partition(".")[0] in OURS and _path(name) is not None
    )


def files_of(modules: Iterable[str]) -> list[Path]:
    """The files that commands depend on, sorted."""
    commands = list(modules)
    todo, seen = [*commands, *(f"{package}.__main__" for package in commands)], set()
    while todo:
        module = todo.pop()
        if module not in seen:
            seen.add(module)
            todo += _imported(module)
    files = {path for module in seen if (path := _path(module))}
    return sorted(files.union(*map(_read_by, files)))


@functools.cache
def content(path: Path) -> bytes:
    """Of a file; comments, docstrings and line breaks of Python count for nothing."""
    content = path.read_bytes()
    if path.suffix == ".py":
        tree = ast.parse(content)
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and (
                ast.get_docstring(node, clean=False) is not None
            ):
                node.body = node.body[1:]
        content = ast.dump(tree).encode()
    return hashlib.sha256(content).digest()


def digest(words: Iterable[str], modules: Iterable[str]) -> str:
    """What changes when a command or a file that it depends on does."""
    whole = hashlib.sha256("\0".join(words).encode())
    for path in files_of(modules):
        whole.update(str(path.relative_to(ROOT)).encode() + content(path))
    return whole.hexdigest()[:16]
