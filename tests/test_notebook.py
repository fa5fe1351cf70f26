"""The notebook runs from its first cell to its last, with small numbers."""

import ast
import json
from pathlib import Path

import numpy as np
import pytest

import medjax

NOTEBOOK = Path(__file__).parent.parent / "notebooks/medjax.ipynb"
CELLS = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
CODE = ["".join(cell["source"]) for cell in CELLS if cell["cell_type"] == "code"]
SMALL = {
    "NUM_ENVS": 2,
    "SECONDS": 3,
    "EPISODES": 2,
    "RUN_DIR": "run",
    "TRAINING": {
        "total_timesteps": 12,
        "num_envs": 2,
        "num_minibatches": 2,
        "rollout_length": 6,
        "num_epochs": 1,
        "hidden": (4,),
    },
}

pytestmark = pytest.mark.usefixtures("quick_compiles")


def test_no_output_is_stored():
    """It would be outdated by the next commit."""
    for cell in CELLS:
        assert cell.get("outputs", []) == []
        assert cell.get("execution_count") is None


@pytest.mark.thorough
def test_cells_run(tmp_path, monkeypatch, capsys):
    """In order, in one namespace, on episodes of six decisions."""
    make = medjax.make
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(medjax, "make", lambda *a, **k: make(*a, **k, episode_decisions=6))
    pytest.importorskip("PIL", reason="pillow missing: pip install -e '.[render]'")
    names = {"__name__": "notebook"}
    exec(CODE[0], names)
    assert names.keys() >= SMALL.keys()
    names.update(SMALL)
    for source in CODE[1:]:
        *body, last = ast.parse(source).body
        exec(compile(ast.Module(body, []), "cell", "exec"), names)
        if isinstance(last, ast.Expr):
            shown = eval(compile(ast.Expression(last.value), "cell", "eval"), names)
        else:
            exec(compile(ast.Module([last], []), "cell", "exec"), names)
    printed = capsys.readouterr().out
    assert "MEDs sent 1" in printed
    assert "'env_steps': 12" in printed
    assert "minus none" in printed
    assert "nan" not in printed
    assert shown.width > shown.height > 100
    assert np.asarray(shown).std() > 10  # not a blank picture
    docs = NOTEBOOK.parent.parent / "docs"
    pages = "".join(
        (docs / name).read_text(encoding="utf-8") for name in ("training.md", "files.md")
    )
    columns = {name.removeprefix("episode_") for name in names["trained"].rows[-1]}
    columns -= {"return", "length", *(f"reward_{name}" for name in names["env"].reward)}
    assert not {column for column in columns if f"`{column}`" not in pages}
    assert (tmp_path / "run/episode.html").stat().st_size > 50_000
