"""The rules for imports and for the sizes of files and functions; docs/architecture.md has the reasons.

Imports within a function are late; they count for every rule, and have one of their own. Those under TYPE_CHECKING
never run, so they cannot close a circle.
"""

import ast
import sys

import pytest

from tests.import_graph import (
    HOUSES,
    ROOT,
    Import,
    arrows,
    graph_of,
    imports_in,
    imports_of,
    modules,
    source_files,
    way,
)

# From the bottom up: a room imports itself, its neighbours on the same line, and the lines above its own.
LEVELS = """
medjax.errors medjax.files medjax.streams medjax.commandline medjax.hooks
medjax.numerics
medjax.physics
medjax.world
medjax.traffic
medjax.charging
medjax.env
medjax.scenarios
medjax.agents
medjax.policies
medjax.wrappers
medjax.episodes
medjax.render
medjax medjax.trajectories
train.option train.settings_file
train.settings
train.algorithms
train.evaluation train.runs train.reporting
train
benchmarks.command
benchmarks.speed
benchmarks.studies benchmarks.verification benchmarks.peers
benchmarks
"""
RANKS = {
    room: rank for rank, rooms in enumerate(LEVELS.split("\n")[1:-1]) for room in rooms.split()
}
LAZY = ("medjax",)
# No path of imports leads from a key to its values.
APART = {
    "medjax.physics": ("medjax.world", "medjax.traffic", "medjax.charging", "medjax.env"),
    "medjax.traffic": ("medjax.charging", "medjax.env"),
    "medjax.env": ("medjax.render", "medjax.policies"),
}

MOST_LINES, MOST_OF_A_FUNCTION, MOST_ARGUMENTS = 300, 60, 7
SOURCES = ("py", "js", "css", "html")
# Public formulas, which take the arguments of the field's equations.
FORMULAS = {"idm_acceleration", "mutual_inductance", "tabulate_inductance", "tractive_energy"}


def room_of(name):
    """The most specific room of LEVELS that contains the module."""
    while name not in RANKS:
        name = name.rpartition(".")[0]
    return name


def is_in(name, room):
    return name == room or name.startswith(room + ".")


def show(name, found, what):
    """Describes a violation."""
    where = modules()[name].path.relative_to(ROOT)
    return f"{where}:{found.line}: {name} imports {found.target}: {what}"


def listed(violations):
    """Each violation once, on a line of its own."""
    return "\n".join(dict.fromkeys(violations))


def test_imports_are_read():
    """Modules, names in packages, late imports, and those for types only."""
    tree = ast.parse(
        "from medjax.traffic import idm, find_neighbours\n"
        "if TYPE_CHECKING:\n    import medjax.render\n"
        "def late():\n    import gymnasium.spaces\n"
    )
    assert [*imports_in(tree, False, False)] == [
        Import("medjax.traffic", 1, is_late=False, is_for_types=False),
        Import("medjax.traffic.idm", 1, is_late=False, is_for_types=False),
        Import("medjax.render", 3, is_late=False, is_for_types=True),
        Import("gymnasium.spaces", 5, is_late=True, is_for_types=False),
    ]


def test_arrows_go_down():
    """A room imports only rooms below it."""
    wrong = (
        show(name, found, f"{room_of(found.target)} is above {room_of(name)}")
        for name, found in arrows()
        if RANKS[room_of(found.target)] > RANKS[room_of(name)]
    )
    assert listed(wrong) == ""


def test_no_circle():
    """Late imports count; reports a shortest circle of each."""
    graph = graph_of((name, found) for name, found in arrows() if not found.is_for_types)
    circles, shown = [], set()
    for name in graph:
        circle = (
            None if name in shown else way(graph, name, lambda target, name=name: target == name)
        )
        if circle:
            circles.append(" imports ".join(circle))
            shown.update(circle)
    assert listed(circles) == ""


@pytest.mark.parametrize("room", APART)
def test_independent_rooms(room):
    """Not even through other modules."""
    graph = graph_of(arrows())
    is_apart = lambda target: any(is_in(target, other) for other in APART[room])  # noqa: E731
    inside = [name for name in modules() if is_in(name, room)]
    ways = (way(graph, name, is_apart) for name in inside)
    assert listed(" imports ".join(found) for found in ways if found) == ""


def test_nothing_imports_a_command():
    """Except the short module that runs it."""
    wrong = (
        show(name, found, "a command")
        for name, found in arrows()
        if modules()[found.target].is_command and not modules()[name].stands_for_another
    )
    assert listed(wrong) == ""


def test_late_imports_are_for_optional_libraries():
    """Or in commands and `import medjax`, which answer --help and bad input without loading JAX."""
    always = {"jax", "flax", "numpy", *HOUSES, *sys.stdlib_module_names}
    wrong = (
        show(name, found, "within a function")
        for name, module in modules().items()
        for found in imports_of(name)
        if found.is_late
        and found.target.partition(".")[0] in always
        and not module.is_command
        and name not in LAZY
    )
    assert listed(wrong) == ""


def test_only_one_module_imports_distrax():
    """It needs nightly builds of another library, so it must be easy to replace."""
    knows = "train.algorithms.networks"
    wrong = (
        show(name, found, f"only {knows} knows distrax")
        for name in modules()
        for found in imports_of(name)
        if found.target.partition(".")[0] == "distrax" and name != knows
    )
    assert listed(wrong) == ""


def test_every_folder_is_a_package():
    """Otherwise mypy and wheels ignore it."""
    folders = {path.parent for path in source_files(*HOUSES, "tests", "docs")}
    wrong = (
        f"{folder.relative_to(ROOT)} has no __init__.py"
        for folder in sorted(folders)
        if not (folder / "__init__.py").exists()
    )
    assert listed(wrong) == ""


def length(path):
    return len(path.read_text(encoding="utf-8").splitlines())


def test_files_are_short():
    """In all languages; docs/live holds generated players."""
    wrong = (
        f"{path.relative_to(ROOT)}: {length(path)} lines, allowed {MOST_LINES}"
        for path in source_files(*HOUSES, "tests", "docs", endings=SOURCES)
        if length(path) > MOST_LINES and path.parent != ROOT / "docs" / "live"
    )
    assert listed(wrong) == ""


def functions():
    """(place, syntax tree) of every function and method."""
    for path in source_files(*HOUSES, "tests", "docs"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                yield f"{path.relative_to(ROOT)}:{node.lineno}: {node.name}", node


def test_functions_are_short():
    """Docstrings included."""
    wrong = (
        f"{where}: {lines} lines, allowed {MOST_OF_A_FUNCTION}"
        for where, node in functions()
        if (lines := node.end_lineno - node.lineno + 1) > MOST_OF_A_FUNCTION
    )
    assert listed(wrong) == ""


def test_functions_take_few_arguments():
    """`self` and `cls` do not count."""
    many = {where: node for where, node in functions() if count_arguments(node) > MOST_ARGUMENTS}
    wrong = (
        f"{where}: {count_arguments(node)} arguments, allowed {MOST_ARGUMENTS}"
        for where, node in many.items()
        if node.name not in FORMULAS
    )
    assert listed(wrong) == ""
    assert {node.name for node in many.values()} >= FORMULAS  # no needless exception


def count_arguments(node):
    given = node.args
    named = [each.arg for each in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
    named += [each.arg for each in (given.vararg, given.kwarg) if each]
    return len(named) - (named[:1] in (["self"], ["cls"]))
