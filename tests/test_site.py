"""The documentation site builds without warnings, broken links or anything from the network."""

import json
import pkgutil
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

ROOT = Path(__file__).parent.parent
NEEDED = ("mkdocs", "material", "mkdocstrings_handlers.python", "latex2mathml")


class Page(HTMLParser):
    """Links, loaded files, anchors and equations of a built page."""

    def __init__(self, text):
        super().__init__()
        self.links, self.loads, self.ids, self.equations = [], [], set(), 0
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.ids |= {given[name] for name in ("id", "name") if given.get(name)}
        self.equations += tag == "math"
        if tag == "a" and given.get("href"):
            self.links.append(given["href"])
        loaded = given.get("href") if tag == "link" else given.get("src")
        if loaded:
            self.loads.append(loaded)


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """The built pages by path; warnings of mkdocs are errors."""
    for module in NEEDED:
        pytest.importorskip(module, reason="pip install -c constraints.txt -e '.[docs]'")
    site = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(site)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert built.returncode == 0, built.stderr
    return {path: Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}


def named(pages, name):
    """Path of the page whose path ends so."""
    return next(path for path in pages if path.as_posix().endswith(f"/{name}"))


def _broken(path, link, pages):
    """Whether an internal link has no target, or an external one is not https."""
    parts = urlsplit(link)
    if parts.scheme or parts.netloc:
        return parts.scheme not in ("https", "mailto", "data") or (
            parts.scheme == "https" and "." not in parts.netloc
        )
    target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if target.is_dir():
        target = target / "index.html"
    if not target.is_file():
        return True
    anchor = unquote(parts.fragment)
    return bool(anchor) and target in pages and anchor not in pages[target].ids


@pytest.mark.thorough
def test_site(pages):
    """Every page of the source is there, with its equations, and every link has a target on this site."""
    names = {path.name for path in pages}
    assert {page.with_suffix(".html").name for page in (ROOT / "docs").glob("*.md")} <= names
    broken = {
        (path.name, link)
        for path, page in pages.items()
        if path.name != "404.html"  # its links are absolute, since it is shown at any address
        for link in page.links + page.loads
        if _broken(path, link, pages)
    }
    assert not broken
    loads = {load for page in pages.values() for load in page.loads}
    assert not [load for load in loads if urlsplit(load).netloc]
    assert pages[named(pages, "models.html")].equations > 30
    assert not [path.name for path in pages if "arithmatex" in path.read_text(encoding="utf-8")]


def test_printed_tables_are_tables(pages):
    """Each number stands under its heading, and no line of dashes is left."""
    for path in pages:
        text = path.read_text(encoding="utf-8")
        text = re.sub(r"<style.*?</style>|<!--.*?-->", "", text, flags=re.DOTALL)
        assert "----------" not in text, path
    results = named(pages, "results.html").read_text(encoding="utf-8")
    row = re.search(r"<tr>\s*<td>budgeted</td>(.*?)</tr>", results, re.DOTALL)
    cells = re.findall(r"<td[^>]*>(.*?)</td>", row[1])
    assert re.fullmatch(r"-?[\d.]+", cells[0])
    assert re.fullmatch(r"\[\S+, \S+\]", cells[1])
    assert len(cells) == 7


def test_search_works_from_a_file(pages, browser):
    """Pages opened from the disk can be searched, and fit a phone's width."""
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    wrong = []
    page.on("console", lambda message: wrong.append(message.text))
    page.on("pageerror", lambda error: wrong.append(str(error)))
    for name in ("index.html", "physics.html"):
        page.goto(next(path for path in pages if path.name == name).as_uri())
        page.focus("input.md-search__input")
        page.keyboard.type("cooldown_s")
        page.wait_for_selector(".md-search-result__item")
        assert "Parameters" in page.inner_text(".md-search-result__list")
    page.set_viewport_size({"width": 390, "height": 844})
    for name in ("index", "results", "parameters", "validation", "api/index"):
        page.goto(named(pages, f"{name}.html").as_uri())
        assert page.evaluate("document.documentElement.scrollWidth") <= 390, name
    page.close()
    assert not wrong


@pytest.mark.parametrize(("width", "height"), [(1024, 768), (390, 800)])
def test_play_is_in_view_on_the_front_page(pages, browser, width, height):
    """Without scrolling; the player fits its frame, and both roads show one stretch."""
    page = browser.new_page(viewport={"width": width, "height": height})
    front = min(
        (path for path in pages if path.name == "index.html"), key=lambda path: len(path.parts)
    )
    page.goto(front.as_uri())
    player = page.frame_locator("iframe[title]")
    player.locator(".view canvas").nth(1).wait_for()
    play = player.locator("#play").bounding_box()
    assert play["x"] >= 0
    assert play["y"] + play["height"] <= height
    # While it plays, the player writes the time after the `#`.
    inside = next(each for each in page.frames if each.url.split("#")[0].endswith("highway.html"))
    assert inside.evaluate("document.documentElement.scrollWidth <= innerWidth")
    first, second = inside.evaluate(
        "medjaxPlayer.views.map(({ road }) => [road.center, road.span])"
    )
    assert first == second
    page.close()


def test_search_ranks_pages_above_the_reference(pages, browser):
    """Titles and sections of pages are in the index, and words that both have find pages first."""
    start = named(pages, "precision.html")  # a small page
    index = json.loads((start.parent / "search/search_index.json").read_text(encoding="utf-8"))
    titles = {entry["location"]: entry["title"] for entry in index["docs"]}
    assert titles["guide.html"] == "The world and its contract"
    assert titles["ablation.html#cooldown"] == "Cooldown"
    for entry in index["docs"]:
        assert entry.get("boost", 1) < 1 or not entry["location"].startswith("api/"), entry
    page = browser.new_page()
    for word in ("cooldown", "freight", "incident", "Gymnasium", "prepare_jax"):
        page.goto(start.as_uri())
        page.focus("input.md-search__input")
        page.keyboard.type(word)
        page.wait_for_selector(".md-search-result__item")
        first = page.locator(".md-search-result__item a").first.get_attribute("href")
        assert ("/api/" in first) == (word == "prepare_jax"), first  # an exact name of the API
    page.close()


def test_notes_on_runs_are_folded(pages):
    """A click opens them; the search leaves them out."""
    for path in pages:
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"<em>Run \d{4}-", text), path
    results = named(pages, "results.html").read_text(encoding="utf-8")
    assert re.search(r"<summary>Took \d+ (s|min)</summary>\s*Run \d{4}-", results)
    index = named(pages, "404.html").parent / "search/search_index.json"
    assert "Took " not in index.read_text(encoding="utf-8")


def test_reference_has_every_public_name(pages):
    import medjax
    import medjax.physics
    import medjax.traffic
    import medjax.wrappers

    ids = {name.rsplit(".", 1)[-1] for page in pages.values() for name in page.ids}
    exported = {
        name
        for module in (medjax, medjax.physics, medjax.traffic, medjax.wrappers)
        for name in module.__all__
        if not name.isupper()  # tables and constants, which have no docstring
    }
    assert sorted(exported - ids) == []


def test_figures_are_drawn_by_the_code(tmp_path):
    """`python -m docs.figures` draws figures that are committed, and pages in docs show all of them."""
    pytest.importorskip("matplotlib", reason="matplotlib missing: pip install -e '.[train]'")
    from docs.figures.__main__ import draw

    names = {path.name for path in draw(tmp_path)}
    text = "".join(page.read_text(encoding="utf-8") for page in (ROOT / "docs").glob("*.md"))
    for name in names:
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
        assert (ROOT / "docs/images" / name).is_file()
        assert f"images/{name}" in text


def test_every_picture_is_shown():
    """A page shows each committed picture."""
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    text = "".join(page.read_text(encoding="utf-8") for page in pages)
    pictures = {path.name for path in (ROOT / "docs/images").iterdir()}
    assert not [name for name in pictures if f"images/{name}" not in text]


def test_every_listed_member_exists():
    """The site leaves out a member that does not exist, without a word."""
    listed = []
    for page in sorted((ROOT / "docs" / "api").glob("*.md")):
        for block in re.split(r"^::: ", page.read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]:
            for names in re.findall(r"members:( \[.*?\]|(?:\n +- \w+)+)", block):
                documented = pkgutil.resolve_name(block.split()[0])
                listed += [(page.name, documented, name) for name in re.findall(r"\w+", names)]
    assert len(listed) > 50
    assert [f"{page}: {name}" for page, where, name in listed if not hasattr(where, name)] == []
