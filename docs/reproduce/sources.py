"""The files that a command's output depends on: the modules that it imports, what these import, and so on."""

import ast
import functools
import hashlib
from collections.abc import Iterable
from pathlib import Path

from docs.reproduce.pages import OURS, ROOT

READ = (".js", ".css", ".html", ".json", ".zip")  # files of its own folders that a module reads


@functools.cache
def _used_by(module: str) -> tuple[set[str], set[Path]]:
    """Modules that one of ours imports or is in; its file, and files in the folders beside it that it names."""
    path = ROOT / module.replace(".", "/")
    path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    if not module.startswith(OURS) or not path.is_file():
        return set(), set()
    modules, words = {module.rpartition(".")[0]}, set[object]()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            modules |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Constant):
            words.add(node.value)
    folders = [each for each in path.parent.iterdir() if each.is_dir() and each.name in words]
    read = {file for each in folders for file in each.rglob("*") if file.suffix in READ}
    return modules, {path, *read}


def files_of(modules: Iterable[str]) -> list[Path]:
    """The files that commands depend on, sorted."""
    todo = [name for module in modules for name in (module, f"{module}.__main__")]
    seen, files = set[str](), set[Path]()
    while todo:
        module = todo.pop()
        if module not in seen:
            imported, used = _used_by(module)
            seen.add(module)
            todo += imported
            files |= used
    return sorted(files)


def digest(words: Iterable[str], modules: Iterable[str]) -> str:
    """Changes with a command and with every file that it depends on."""
    whole = hashlib.sha256("\0".join(words).encode())
    for path in files_of(modules):
        whole.update(str(path.relative_to(ROOT)).encode() + path.read_bytes())
    return whole.hexdigest()[:16]
