"""What `import medjax` loads, and where Gymnasium finds the environment; each in a process of its own."""

import subprocess
import sys

import pytest

ID = "medjax/Charging-v0"


def failure_of(code):
    """What a process that runs the code ends with: its code, and what it says if that is not 0."""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    return ended.returncode, ended.stderr if ended.returncode else ""


def test_import_pulls_in_no_plotting():
    """`import medjax` loads neither a plotting library nor the trainer's dependencies."""
    code = (
        "import sys, medjax; bad = {'matplotlib', 'PIL', 'gymnasium', 'distrax', 'optax', 'tensorboardX'} & "
        "set(sys.modules); sys.exit(str(bad) if bad else 0)"
    )
    assert failure_of(code) == (0, "")


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
    """Whoever is loaded first."""
    pytest.importorskip("gymnasium")
    assert failure_of(code) == (0, "")
