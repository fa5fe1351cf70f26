"""Blocks are kept across a change that leaves all bits as they were, and no others."""

import subprocess

import numpy as np
import pytest

from docs.reproduce import __main__ as command
from docs.reproduce import run, same
from docs.reproduce.pages import ROOT, all_blocks
from tests.reproduce.conftest import PRINTED


def in_both(book):
    """The commands of all blocks, as those of another tree."""
    return {name: [list(words) for words in each.commands] for name, each in book.blocks.items()}


def among(*changed):
    """Says of a file whether it is one that differs."""
    return lambda path: str(path.relative_to(same.ROOT)) in changed


def test_blocks_whose_bits_are_the_same_are_kept(book, monkeypatch):
    """With what trains for them, where nothing else that they depend on has changed; their run is still the old one."""
    count, learn = book.blocks["count"], book.blocks["learn"]
    monkeypatch.setattr(run, "_printed", lambda block: PRINTED)
    book.run(learn)
    book.run(count)
    monkeypatch.setattr(book, "seconds", lambda block: 60)
    was, stamps = in_both(book), dict(book.stamps)
    assert same.unchanged(book, was, among()) == []  # they are current
    monkeypatch.setattr(run, "digest", lambda words, modules: f"new {sorted(words)}")
    assert same.unchanged(book, was, among("medjax/env/tick.py")) == ["count", "learn"]
    for played in ("train/evaluate.py", "medjax/commandline.py", "medjax/render/web/player.js"):
        assert same.unchanged(book, was, among(played)) == ["count", "learn"]
    assert same.unchanged(book, was | {"learn": [["train.ppo", "--seed", "1"]]}, among()) == []
    assert same.unchanged(book, {"count": was["count"]}, among()) == []  # it was older there, too
    with monkeypatch.context() as patched:  # did golden not go through it
        others = [name for name in same.PLAYED if name != "train/evaluate.py"]
        patched.setattr(same, "PLAYED", tuple(others))
        assert same.unchanged(book, was, among("train/evaluate.py")) == ["learn"]
    book.keep(["count", "learn"])
    assert book.is_current(count)
    assert book.is_current(learn)
    for name, stamp in run.Book(book.blocks).stamps.items():
        assert stamp == stamps[name] | {"sources": book.digest(book.blocks[name])}


def test_speed_is_not_a_matter_of_bits():
    """Nor is what is printed in no time."""
    everything = run.Book(all_blocks())
    everything.stamps = {name: stamp | {"sources": ""} for name, stamp in everything.stamps.items()}
    kept = same.unchanged(everything, in_both(everything), among("medjax/env/tick.py"))
    assert {"evaluation", "validation", "power", "ippo-evaluation"} <= set(kept)
    assert not {"throughput", "training-speed", "peers", "speed-agents", "parameters"} & set(kept)
    study = among("benchmarks/studies/ablation/sweeps.py")
    kept = set(same.unchanged(everything, in_both(everything), study))
    assert not {"power", "fleet-30", "cooldown"} & kept
    assert {"evaluation", "calibrate", "ippo"} <= kept
    # That of the planner is played by golden, too.
    assert "planner" in same.unchanged(
        everything, in_both(everything), among("benchmarks/studies/planner.py")
    )


def test_only_blocks_of_presets_that_are_the_same_are_kept():
    """With what trains for them; of commands that play more than one preset none is."""
    everything = run.Book(all_blocks())
    everything.stamps = {name: stamp | {"sources": ""} for name, stamp in everything.stamps.items()}
    was = in_both(everything)
    kept = set(same.unchanged(everything, was, among("medjax/env/tick.py"), ["corridor"]))
    assert {"evaluation", "calibrate", "ippo-evaluation", "fleet-30", "planner"} <= kept
    assert not {"power", "corridor-ippo", "corridor-ippo-evaluation"} & kept
    assert not {"validation", "generalization", "ticks"} & kept
    kept = set(same.unchanged(everything, was, among("medjax/env/tick.py"), ["paper"]))
    assert "power" in kept
    assert not {"evaluation", "fleet-30", "validation"} & kept


def test_presets_that_differ_are_named(tmp_path, capfd):
    """Those of the worlds and trainings in which a bit does; a file that cannot be read is an error."""
    worlds = {"paper/reward": 1.0, "trips/reward": 1.0, "training/kl": 1.0}
    for file, changes in (
        ("was", {}),
        ("trips", {"trips/reward": 2.0}),
        ("training", {"training/kl": 2.0}),
        ("more", {"training/entropy": 1.0}),
    ):
        np.savez(
            tmp_path / f"{file}.npz", **{k: np.array([v]) for k, v in (worlds | changes).items()}
        )
    was = tmp_path / "was.npz"
    assert same._other_presets(was, was) == []
    assert same._other_presets(was, tmp_path / "trips.npz") == ["corridor"]
    assert "trips/reward: 1 of 1 differ" in capfd.readouterr().out
    assert same._other_presets(was, tmp_path / "training.npz") == ["paper"]
    # What is told on top of it changes nothing; what is told no more does.
    assert same._other_presets(was, tmp_path / "more.npz") == []
    was.with_suffix(".json").unlink()
    more = (tmp_path / "more.npz").rename(tmp_path / "less.npz")
    assert same._other_presets(more, was) == ["paper"]
    with pytest.raises(subprocess.CalledProcessError):
        same._other_presets(was, tmp_path / "absent.npz")


def test_pictures_are_of_what_draws():
    """The player's of the player, all of the colours; figures in words of neither."""
    everything = run.Book(all_blocks())
    everything.stamps = {name: stamp | {"sources": ""} for name, stamp in everything.stamps.items()}
    for drawing, other in (
        ("packing.py", {"highway", "live"}),
        ("web/events.js", {"highway", "live"}),
        ("colors.py", {"highway", "live", "report", "generalization"}),
    ):
        changed = among(f"medjax/render/{drawing}")
        kept = set(same.unchanged(everything, in_both(everything), changed))
        assert {"evaluation", "motion"} <= kept
        assert not other & kept
        assert ("report" in kept) == ("report" not in other)


def test_trees_are_compared_where_blocks_may_be_kept(monkeypatch, capsys):
    """This tree is played once; blocks of presets that differ are not kept."""
    played, kept, differ = [], [], []
    monkeypatch.setattr(same, "_play", lambda tree, out: (played.append(tree), out.touch()))
    monkeypatch.setattr(same, "_current", lambda tree: {})
    monkeypatch.setattr(same, "unchanged", lambda *given: [] if ["paper"] in given else ["tune"])
    monkeypatch.setattr(same, "_other_presets", lambda was, now: differ)
    monkeypatch.setattr(run.Book, "keep", lambda book, names: kept.append(names))
    assert command.main(["--same-bits-as", "HEAD", "HEAD"]) == 0
    assert played[0] == ROOT
    assert len(played) == 2
    assert kept == [["tune"]]
    assert capsys.readouterr().out == "1 blocks are of these files, too: tune\n"

    differ.append("paper")
    assert command.main(["--same-bits-as", "HEAD"]) == 0
    assert kept[1:] == [[]]
    assert capsys.readouterr().out == "0 blocks are of these files, too: \n"
    with pytest.raises(SystemExit) as end:
        command.main(["--same-bits-as", "HEAD", "no-such-commit"])
    assert end.value.code == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "no-such-commit" in said
    assert len(kept) == 2
