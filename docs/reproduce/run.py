"""Runs blocks of the pages, and says which have to be."""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
import sys
import time
from collections.abc import Collection, Mapping
from datetime import date
from typing import Any

from docs.reproduce.pages import ROOT, RUN_NOTE, Block, with_note, with_output
from docs.reproduce.sources import digest
from medjax.commandline import in_words
from train.runs.versions import versions

STAMPS = ROOT / "docs/reproduced.json"
WORK = ROOT / "build/reproduce"  # where commands run: their runs and files stay there
PATIENCE_S = 10.0  # with a command that is to end: a training saves first


class Book:
    """All blocks, and what is known of their last runs."""

    def __init__(self, blocks: Mapping[str, Block]) -> None:
        self.blocks = blocks
        text = STAMPS.read_text(encoding="utf-8") if STAMPS.is_file() else "{}"
        self.stamps: dict[str, dict[str, Any]] = json.loads(text)

    def needs(self, block: Block) -> list[Block]:
        """Blocks that train what this one plays."""
        return [
            other
            for other in self.blocks.values()
            if any(f"{word}/".startswith(f"{run}/") for run in other.learns for word in block.reads)
        ]

    def digest(self, block: Block) -> str:
        """Of its commands, of the files that they depend on, and of what it needs."""
        words = [word for words in block.commands for word in words]
        words += [self.digest(other) for other in self.needs(block)]
        return digest(words, [words[0] for words in block.commands])

    def is_current(self, block: Block) -> bool:
        """Whether it was run on the files as they are."""
        return self.stamps.get(block.name, {}).get("sources") == self.digest(block)

    def seconds(self, block: Block) -> int:
        """How long it took last, or takes as its page says."""
        return int(self.stamps.get(block.name, {}).get("seconds", block.expected_s))

    def state(self, block: Block) -> str:
        """For people."""
        stamp = self.stamps.get(block.name)
        if stamp is None:
            return "never run by this command"
        when = f"{stamp['date']}, {stamp['commit']}"
        return when if self.is_current(block) else f"older than its files: {when}"

    def order(self, chosen: Collection[Block], again: bool) -> list[Block]:
        """What is to be run: those chosen that are not current, each behind what it needs."""
        todo: list[Block] = []
        for block in chosen:
            if self.is_current(block) and not again:
                continue
            makers = [
                other
                for other in self.needs(block)
                if not self.is_current(other) or not all((WORK / d).is_dir() for d in other.learns)
            ]
            todo += [other for other in (*makers, block) if other not in todo]
        return todo

    def run(self, block: Block) -> bool:
        """Runs a block and writes its page and its stamp. Returns whether the text that the page shows has changed.

        Raises:
          RuntimeError: a command failed; the page is as it was.
        """
        began, sources, ran = time.monotonic(), self.digest(block), versions()
        printed = _printed(block)
        stamp = {
            "page": str(block.page.relative_to(ROOT)),
            "command": [" ".join(words) for words in block.commands],
            "commit": ran["commit"],
            "date": date.today().isoformat(),
            "seconds": round(time.monotonic() - began),
            "machine": f"{os.cpu_count()} cores, {platform.machine()}",
            "versions": {name: ran[name] for name in ("python", "jax", "numpy")},
            "sources": sources,
        }
        before = block.page.read_text(encoding="utf-8")
        after = with_output(before, block.name, printed, lambda file, to: _take(block, file, to))
        block.page.write_text(with_note(after, block.name, note(stamp)), encoding="utf-8")
        self._write({block.name: stamp})
        return before != after

    def keep(self, names: Collection[str]) -> None:
        """Blocks whose files have changed but not what they print: these are their files now."""
        self._write(
            {
                name: self.stamps[name] | {"sources": self.digest(self.blocks[name])}
                for name in names
            }
        )

    def _write(self, stamps: Mapping[str, dict[str, Any]]) -> None:
        self.stamps = dict(sorted({**self.stamps, **stamps}.items()))
        STAMPS.write_text(json.dumps(self.stamps, indent=2) + "\n", encoding="utf-8")


def note(stamp: Mapping[str, Any]) -> str:
    """The line of a page that says when and on what a command was run."""
    versions = stamp["versions"]
    return RUN_NOTE.format(
        date=stamp["date"],
        time=in_words(stamp["seconds"]),
        commit=stamp["commit"],
        versions=f"JAX {versions['jax']}, Python {versions['python']}",
        machine=stamp["machine"],
    )


def _printed(block: Block) -> str:
    """What the last command of a block prints."""
    WORK.mkdir(parents=True, exist_ok=True)
    for directory in block.learns:  # training starts anew
        shutil.rmtree(WORK / directory, ignore_errors=True)
    printed = ""
    for module, *arguments in block.commands:
        with subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            cwd=WORK,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            stdout=subprocess.PIPE,
            text=True,
        ) as child:
            try:
                printed, _ = child.communicate()
            except KeyboardInterrupt:
                _end(child)
                raise
        if child.returncode:
            raise RuntimeError(f"{block.name}: {module} ended with exit code {child.returncode}")
    return printed


def _end(child: subprocess.Popen[str]) -> None:
    """Ends a command, and what it has started itself where it has the time for that."""
    child.terminate()
    try:
        child.wait(PATIENCE_S)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()


def _take(block: Block, file: str, picture: str) -> None:
    """A picture that a command wrote becomes that of the page."""
    shutil.copyfile(WORK / file, block.page.parent / picture)
