"""Reads YAML into plain values; errors take one line."""

from typing import Any

import yaml

from medjax.commandline import named_once
from medjax.errors import InputError


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
