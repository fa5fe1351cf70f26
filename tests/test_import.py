"""What `import medjax` loads, and where Gymnasium finds the environment; each in a process of its own."""

import subprocess
import sys

import pytest

ID = "medjax/Charging-v0"


def ends_well(code):
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr


def test_import_pulls_in_no_plotting():
    """`import medjax` loads neither a plotting library nor the trainer's dependencies."""
    ends_well(
        "import sys, medjax; bad = {'matplotlib', 'PIL', 'gymnasium', 'distrax', 'optax', 'tensorboardX'} & "
        "set(sys.modules); sys.exit(str(bad) if bad else 0)"
    )


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
    ends_well(code)
