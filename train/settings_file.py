"""Reads a file of settings, JSON or YAML, into plain values; errors take one line."""

from pathlib import Path
from typing import Any

import yaml

from medjax.commandline import named_once, read_json
from medjax.errors import InputError
from medjax.files import check_input

MOST_BYTES = 2**16  # in a file of settings


def read_file(path: Path) -> Any:
    """The content of a file of settings; its suffix tells YAML from JSON.

    Raises:
        InputError: the file is missing, too long, cannot be read, or holds neither.
    """
    check_input("settings", path)
    try:
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from None
    if len(content) > MOST_BYTES:
        raise InputError(f"{path} is too long, allowed: at most {MOST_BYTES} bytes")
    is_yaml = path.suffix in (".yaml", ".yml")
    try:
        return read_yaml(content.decode()) if is_yaml else read_json(content.decode())
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a text file") from None
    except (ValueError, RecursionError):
        raise InputError(f"{path} is not a {'YAML' if is_yaml else 'JSON'} file") from None


def read_yaml(text: str) -> Any:
    """A YAML value of plain types.

    Raises:
        InputError: a name appears twice, or there is an alias.
        ValueError: the text is not YAML.
    """
    try:
        return yaml.load(text, Loader=_PlainLoader)
    except InputError:
        raise
    except Exception:  # PyYAML passes on any exception of its constructors
        raise ValueError("not YAML") from None


class _PlainLoader(yaml.SafeLoader):
    """A loader without aliases, because a few lines of them can expand beyond the memory."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise InputError("it has an alias, allowed: values written out")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        named_once([(key.value, None) for key, _ in node.value if isinstance(key.value, str)])
        return super().construct_mapping(node, deep)
