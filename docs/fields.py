"""Documents fields of classes in the API reference from their comment, `option(...)` or `number(...)`.

By itself mkdocstrings reads docstrings only.
"""

import ast
from typing import Any

import griffe

SETTING = "option"  # of train.settings: its third argument is the help of the command line
NUMBER = "number"  # of medjax.world.numbers: default, lowest, highest, unit, text


class FieldComments(griffe.Extension):
    """Adds the section `Attributes` to the docstring of a class that has none."""

    def on_class_members(
        self, *, node: Any, cls: griffe.Class, agent: griffe.Visitor | griffe.Inspector, **_: Any
    ) -> None:
        """Called by griffe when it has read a class."""
        docstring = cls.docstring
        if not isinstance(node, ast.ClassDef) or docstring is None:
            return
        if "Attributes:" in docstring.value or not isinstance(agent, griffe.Visitor):
            return
        source = agent.code.splitlines()
        fields = [
            (statement.target.id, _comment(source[statement.lineno - 1]) or _help(statement))
            for statement in node.body
            if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name)
        ]
        if fields:
            listed = "\n".join(f"    {name}: {text}" for name, text in fields)
            docstring.value += f"\n\nAttributes:\n{listed}"


def _comment(line: str) -> str:
    return line.partition("  # ")[2].strip()


def _help(statement: ast.AnnAssign) -> str:
    """Description of a field from its default."""
    call = statement.value
    if isinstance(call, ast.Constant):
        return f"default: {ast.unparse(call)}"
    function = getattr(call.func, "id", "") if isinstance(call, ast.Call) else ""
    if not isinstance(call, ast.Call) or function not in (SETTING, NUMBER):
        return ""
    default = ast.unparse(call.args[0])
    if function == SETTING:
        return f"{ast.literal_eval(call.args[2])} (default: {default})"
    given = dict(zip(("default", "low", "high", "unit", "text"), call.args, strict=False))
    given |= {keyword.arg: keyword.value for keyword in call.keywords if keyword.arg}
    unit, text = (
        ast.literal_eval(given[name]) if name in given else "" for name in ("unit", "text")
    )
    said = "; ".join(text) if isinstance(text, tuple) else text
    low, high = ast.unparse(given["low"]), ast.unparse(given["high"])
    return f"{said} ({unit + ', ' if unit else ''}default: {default}, allowed: {low} to {high})"
