"""What `import medjax` loads, and where Gymnasium finds the environment."""

import subprocess
import sys

import pytest

ID = "medjax/Charging-v0"


def run(code):
    """Runs the code in a process of its own; returns its exit code and, if that is not 0, its stderr."""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    return ended.returncode, ended.stderr if ended.returncode else ""


def test_import_pulls_in_no_plotting():
    """`import medjax` loads neither a plotting library nor the trainer's dependencies."""
    code = (
        "import sys, medjax; bad = {'matplotlib', 'PIL', 'gymnasium', 'distrax', 'optax', 'tensorboardX', "
        "'medjax.render'} & set(sys.modules); sys.exit(str(bad) if bad else 0)"
    )
    assert run(code) == (0, "")


@pytest.mark.parametrize(
    "code",
    [
        f"import gymnasium; gymnasium.make('medjax:{ID}')",
        f"import gymnasium, medjax; gymnasium.make('{ID}')",
        f"import medjax, gymnasium, medjax.wrappers.gymnasium; gymnasium.make('{ID}')",
        f"import medjax, gymnasium; gymnasium.make('medjax.wrappers.gymnasium:{ID}')",
        f"import gymnasium; gymnasium.make_vec('medjax.wrappers.gymnasium:{ID}', num_envs=2)",
    ],
)
def test_gymnasium_finds_the_environment(code):
    """Whichever library is loaded first."""
    pytest.importorskip("gymnasium")
    assert run(code) == (0, "")
