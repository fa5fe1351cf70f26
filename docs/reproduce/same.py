"""Keeps blocks that a change has made older than their files, where the change leaves every bit as it was.

What golden plays and trains (`benchmarks.verification.golden`) is played in an earlier tree and in this one, and
compared bit for bit. Blocks of a preset of which nothing differs, that were of that tree's files, and depend on nothing
else that has changed, are of this tree's, too. Their stamps still say when, on what and at which commit they were run.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from docs.reproduce.pages import ROOT, Block
from docs.reproduce.run import Book
from docs.reproduce.sources import content, files_of

GOLDEN = Path("benchmarks/verification/golden.py")
PLAY = [sys.executable, "-m", ".".join(GOLDEN.with_suffix("").parts)]
# What golden goes through; pictures, other studies and other commands it does not.
PLAYED = (
    *("train/__init__.py", "benchmarks/__init__.py"),
    *(f"medjax/{module}.py" for module in ("__init__", "agents", "early", "scenarios")),
    *(f"medjax/{module}.py" for module in ("commandline", "errors", "files", "hooks")),
    *(f"medjax/{room}/" for room in ("world", "physics", "traffic", "charging", "env", "policies")),
    *("medjax/episodes/", "medjax/numerics/", "medjax/wrappers/"),
    *("train/algorithms/", "train/runs/", "train/evaluation/"),
    *(f"train/{module}.py" for module in ("evaluate", "option", "ppo", "settings", "yaml_file")),
    *(f"benchmarks/{module}.py" for module in ("planner", "studies/base", "studies/planner")),
)
# What only draws: of no matter to a block without a picture, but for those of its own commands.
DRAWS = ("medjax/render/", "train/reporting/")
# Commands that play one preset: that of --scenario or of the run that they read, else `paper`.
ONE_PRESET = (
    *("train.ppo", "train.evaluate"),
    *(f"benchmarks.{name}" for name in ("ablation", "agents", "calibrate", "planner", "tune")),
)
QUICK_S = 10  # what is run anew sooner than it is reasoned about
CURRENT = """
import json
from docs.reproduce.pages import all_blocks
from docs.reproduce.run import Book
book = Book(all_blocks())
print(json.dumps({name: each.commands for name, each in book.blocks.items() if book.is_current(each)}))
"""


def is_commit(name: str) -> bool:
    """Whether this repository has it."""
    words = ["git", "-C", str(ROOT), "rev-parse", "--quiet", "--verify", f"{name}^{{commit}}"]
    return subprocess.run(words, capture_output=True, check=False).returncode == 0


def keep(book: Book, commits: Sequence[str]) -> list[str]:
    """Stamps the blocks that are as they were at one of these commits, and says what is not. Returns their names.

    Raises:
      CalledProcessError: a command failed; no stamp is changed.
    """
    found: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        now = Path(folder) / "now.npz"
        for number, commit in enumerate(commits):
            with _tree(commit, Path(folder) / f"tree-{number}") as before:
                find = partial(unchanged, book, _current(before), _differs_from(before))
                if not set(find()) - set(found):
                    continue
                if not now.exists():
                    _play(ROOT, now)
                _play(before, was := Path(folder) / f"{number}.npz")
                found += [name for name in find(_other_presets(was, now)) if name not in found]
    book.keep(found)
    return found


def unchanged(
    book: Book,
    current: Mapping[str, Sequence[Sequence[str]]],
    differs: Callable[[Path], bool],
    others: Collection[str] = (),
) -> list[str]:
    """Blocks that only changes of what golden goes through have made older than their files.

    Args:
      book: of this tree.
      current: the commands of those that were of their files in the other tree, by name.
      differs: whether a file of this tree is another one there, or not there.
      others: presets in which golden's bits are others there.
    """

    def is_kept(block: Block) -> bool:
        same = [list(words) for words in current.get(block.name, ())] == list(
            map(list, block.commands)
        )
        speed = block.page.stem == "performance" or block.name.startswith("speed-")
        if not same or speed or book.seconds(block) < QUICK_S:
            return False
        if others and not all(_plays_none_of(others, words) for words in block.commands):
            return False
        modules = [words[0] for words in block.commands]
        drawn = block.has_pictures or any(m.replace(".", "/").startswith(DRAWS) for m in modules)
        fine = PLAYED if drawn else (*PLAYED, *DRAWS)
        changed = [str(path.relative_to(ROOT)) for path in files_of(modules) if differs(path)]
        return all(name.startswith(fine) for name in changed)

    candidates = {block.name: is_kept(block) for block in book.blocks.values()}
    return [
        name
        for name, block in book.blocks.items()
        if candidates[name]
        and not book.is_current(block)
        and all(candidates[other.name] or book.is_current(other) for other in book.needs(block))
    ]


def _plays_none_of(presets: Collection[str], words: Sequence[str]) -> bool:
    """Whether a command is known to; what reads a run is judged by what trains it, too (`Book.needs`)."""
    own = words[words.index("--scenario") + 1] if "--scenario" in words else "paper"
    return words[0] in ONE_PRESET and own not in presets


@contextmanager
def _tree(commit: str, folder: Path) -> Iterator[Path]:
    """A checkout of a commit, with this tree's golden, so that both play the same."""
    git = ["git", "-C", str(ROOT), "worktree"]
    subprocess.run([*git, "add", "--detach", str(folder), commit], check=True, capture_output=True)
    try:
        yield folder
    finally:
        subprocess.run([*git, "remove", "--force", str(folder)], check=True)


def _current(tree: Path) -> dict[str, list[list[str]]]:
    """Commands of the blocks of a tree that are of its files, by name."""
    done = subprocess.run(
        [sys.executable, "-c", CURRENT], cwd=tree, check=True, stdout=subprocess.PIPE, text=True
    )
    return json.loads(done.stdout)  # type: ignore[no-any-return]


def _differs_from(tree: Path) -> Callable[[Path], bool]:
    def differs(path: Path) -> bool:
        other = tree / path.relative_to(ROOT)
        return not other.is_file() or content(other) != content(path)

    return differs


def _play(tree: Path, out: Path) -> None:
    """What this tree's golden finds in a tree."""
    if tree != ROOT:
        shutil.copy(ROOT / GOLDEN, tree / GOLDEN)
    subprocess.run([*PLAY, "--training", f"--out={out}"], cwd=tree, check=True)


def _other_presets(was: Path, now: Path) -> list[str]:
    """Presets of which some bits differ; which bits is printed."""
    found = was.with_suffix(".json")
    words = [*PLAY, "--compare", str(was), str(now), f"--json={found}"]
    done = subprocess.run(words, cwd=ROOT, check=False)
    if not found.is_file():
        done.check_returncode()  # which is no 0 where some differ, either
    return list(json.loads(found.read_text(encoding="utf-8"))["presets"])
