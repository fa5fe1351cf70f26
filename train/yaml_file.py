"""What files say in YAML, or one line on why they say nothing."""

from typing import Any

import yaml

from medjax.commandline import named_once
from medjax.errors import InputError


def read_yaml(text: str) -> Any:
    """A YAML value of plain types.

    Raises:
        InputError: a name is given twice, or there is an alias.
        ValueError: it is not YAML.
    """
    try:
        return yaml.load(text, Loader=_PlainLoader)
    except InputError:
        raise
    except Exception:  # PyYAML lets through whatever its constructors meet
        raise ValueError("not YAML") from None


class _PlainLoader(yaml.SafeLoader):
    """Without aliases, of which a few lines can make more than memory holds."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise InputError("it has an alias, allowed: values written out")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        named_once([(key.value, None) for key, _ in node.value if isinstance(key.value, str)])
        return super().construct_mapping(node, deep)
