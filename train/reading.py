"""What files and options say in JSON and YAML, or one line on why they say nothing."""

import json
from typing import Any

import yaml

from train.wording import SettingError, shown


def read_json(text: str) -> Any:
    """A JSON value.

    Raises:
        SettingError: a name is given twice.
        ValueError: it is not JSON.
        RecursionError: it is nested deeper than Python goes.
    """
    return json.loads(text, object_pairs_hook=_mapping)


def read_yaml(text: str) -> Any:
    """A YAML value of plain types.

    Raises:
        SettingError: a name is given twice, or there is an alias.
        ValueError: it is not YAML.
    """
    try:
        return yaml.load(text, Loader=_PlainLoader)
    except SettingError:
        raise
    except Exception:  # PyYAML lets through whatever its constructors meet
        raise ValueError("not YAML") from None


def read_value(text: str) -> Any:
    """The value in `NAME=VALUE`: JSON, a number as Python writes it (`1.`, `inf`, `nan`), or else the text."""
    try:
        return read_json(text)
    except SettingError:
        raise
    except (ValueError, RecursionError):
        pass
    try:
        return float(text) if text.isascii() else text
    except ValueError:
        return text


class _PlainLoader(yaml.SafeLoader):
    """Without aliases, of which a few lines can make more than memory holds."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise SettingError("it has an alias, allowed: values written out")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        _mapping([(key.value, None) for key, _ in node.value if isinstance(key.value, str)])
        return super().construct_mapping(node, deep)


def _mapping(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise SettingError(f"{shown(name)} is there twice, allowed: once")
        found[name] = value
    return found
