#!/usr/bin/env bash
# ruff 0.17.5 and jaxtyping 0.3.11: a fix that ruff calls safe turns shapes into names that do not exist
#
# One would expect: `Float[Array, "num_vehicles"]` may need codes silenced (ruff's F722 and F821 complain about shapes), but
# no safe fix of a linter changes what an annotation means.
# What happens: in a file with `from __future__ import annotations`, UP037 (quoted-annotation, of the set "UP") takes a
# shape of one name for a forward reference and removes its quotes. `ruff check --fix` reports that all is well, and the
# file still imports, since annotations are not evaluated. Whoever evaluates them (typing.get_type_hints, beartype,
# jaxtyping's import hook) gets a NameError. A shape of two names keeps its quotes; the shape "2" becomes an int.
# Source: https://docs.astral.sh/ruff/rules/quoted-annotation ("The rule's fix is marked as safe")
#
# Output seen:
# before: Float[Array, "num_vehicles"] Float[Array, "2"] Float[Array, "rows columns"]
# after: Float[Array, num_vehicles] Float[Array, 2] Float[Array, "rows columns"]
# hints before: ok
# hints after: NameError: name 'num_vehicles' is not defined
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install -q ruff==0.17.5 jaxtyping==0.3.11 numpy==2.4.6
cat > road.py <<'PYTHON'
from __future__ import annotations

from jaxtyping import Float
from numpy import ndarray as Array


class Road:
    x: Float[Array, "num_vehicles"]
    ends: Float[Array, "2"]
    cells: Float[Array, "rows columns"]
PYTHON
cat > hints.py <<'PYTHON'
import typing

import road

try:
    typing.get_type_hints(road.Road)
    print("ok")
except Exception as error:
    print(f"{type(error).__name__}: {error}")
PYTHON
annotations() { grep -o 'Float\[.*\]' road.py | tr '\n' ' ' | sed 's/ $//'; }
echo "before: $(annotations)"
before=$(venv/bin/python hints.py)
venv/bin/ruff check -q --no-cache --isolated --select UP --fix road.py
echo "after: $(annotations)"
after=$(venv/bin/python hints.py)
echo "hints before: $before"
echo "hints after: $after"
[[ $before == ok && $after == NameError* ]] || { echo "the behaviour has changed"; exit 1; }
