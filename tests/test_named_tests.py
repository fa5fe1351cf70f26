"""Tests that a page names exist, so that a reader can run them."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
NAMES = {
    f"/{path.relative_to(ROOT)}": re.findall(r"^def (test_\w+)", path.read_text(), re.MULTILINE)
    for path in (ROOT / "tests").rglob("test_*.py")
}
SELECTION = re.compile(r"`((?:\w+/)*test_\w+\.py) -k \"?([\w ]+)\"?`")
SELECTIONS = [
    (page.name, file, word)
    for page in sorted((ROOT / "docs").glob("*.md"))
    for file, words in SELECTION.findall(page.read_text())
    for word in words.split(" or ")
]
PRECISION = ("test_precision.py", "test_battery_precision.py", "test_order_precision.py")


def names_in(file):
    """Tests of all files of this name, or of this path."""
    return [name for path, names in NAMES.items() if path.endswith(f"/{file}") for name in names]


def test_pages_select_tests():
    """The pattern finds the selections that are there."""
    assert len(SELECTIONS) >= 20


@pytest.mark.parametrize(("page", "file", "word"), SELECTIONS)
def test_each_word_of_a_selection_finds_a_test(page, file, word):
    assert any(word in name for name in names_in(file))


def test_tests_in_the_table_of_bounds_exist():
    """The last column of docs/precision.md has their names without `test_`."""
    rows = re.findall(r"^\|.*\|([^|]*)\|$", (ROOT / "docs/precision.md").read_text(), re.MULTILINE)
    named = [name for cell in rows for name in re.findall(r"`(\w+)`", cell)]
    assert len(named) >= 8
    there = [name.removeprefix("test_") for file in PRECISION for name in names_in(file)]
    assert {name for name in named if not any(own.startswith(name) for own in there)} == set()
