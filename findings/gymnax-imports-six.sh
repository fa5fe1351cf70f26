#!/usr/bin/env bash
# gymnax 1.0.1: `import gymnax` fails in an environment that holds nothing but gymnax and what it asks for.
#
# Expected: `pip install gymnax` and `import gymnax` work, as they do on nearly every machine: many packages bring six.
# What happens: gymnax/utils/load_mnist.py imports six.moves, a package for Python 2, which gymnax does not declare; and
#   gymnax/environments/bsuite, which needs it, is imported with the package. A pinned, minimal image ends in
#   ModuleNotFoundError, whatever environment one meant to use. With six beside it, all is well.
# Source: the file named, and `Requires-Dist` of the wheel.
# Output seen:
#   gymnax 1.0.1 declares six: False
#   import gymnax: ModuleNotFoundError: No module named 'six'
#   with six: imported
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check "gymnax==1.0.1"
"$folder/venv/bin/python" - <<'PYTHON'
from importlib.metadata import requires, version

declared = any(name.startswith("six") for name in requires("gymnax"))
print(f"gymnax {version('gymnax')} declares six: {declared}")
assert not declared
try:
    import gymnax
except ModuleNotFoundError as error:
    print(f"import gymnax: ModuleNotFoundError: {error}")
    assert error.name == "six"
else:
    raise SystemExit("import gymnax: no error")
PYTHON
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check six
"$folder/venv/bin/python" -c "import gymnax; print('with six: imported')"
