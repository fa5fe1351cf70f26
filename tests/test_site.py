"""The documentation site: no warning, no link that leads nowhere, nothing from the network."""

import importlib.util
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

from tests.render.browser import chromium_program

ROOT = Path(__file__).parent.parent
NEEDED = ("mkdocs", "material", "mkdocstrings_handlers.python", "latex2mathml")


def _is_installed(module):
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:
        return False


MISSING = [module for module in NEEDED if not _is_installed(module)]
needs_mkdocs = pytest.mark.skipif(
    bool(MISSING),
    reason=f"{', '.join(MISSING)} missing: pip install -c constraints.txt -e '.[docs]'",
)


class Page(HTMLParser):
    """What a built page refers to, and what may be referred to in it."""

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
    """The built pages by their path; warnings of mkdocs are errors."""
    site = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(site)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert built.returncode == 0, built.stderr
    return {path: Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}


def _broken(path, link, pages):
    """Whether an internal link leads nowhere, or an external one is no https address or is in the page itself."""
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


@needs_mkdocs
def test_site(pages):
    """All pages of the source are there, with whole equations, and every link leads somewhere."""
    names = {path.name for path in pages}
    assert {page.with_suffix(".html").name for page in (ROOT / "docs").glob("*.md")} <= names
    broken = {
        (path.name, link)
        for path, page in pages.items()
        if path.name != "404.html"  # its links are absolute: it is shown at any address
        for link in page.links + page.loads
        if _broken(path, link, pages)
    }
    assert not broken
    loads = {load for page in pages.values() for load in page.loads}
    assert not [load for load in loads if urlsplit(load).netloc]
    models = next(path for path in pages if path.name == "models.html")
    assert pages[models].equations > 30
    assert not [path.name for path in pages if "arithmatex" in path.read_text(encoding="utf-8")]


@needs_mkdocs
def test_printed_tables_are_tables(pages):
    """Whatever command printed them: each number under its heading, and no line of dashes is left."""
    for path in pages:
        text = path.read_text(encoding="utf-8")
        assert "----------" not in re.sub(
            r"<style.*?</style>|<!--.*?-->", "", text, flags=re.DOTALL
        ), path
    results = next(path for path in pages if path.name == "results.html").read_text(
        encoding="utf-8"
    )
    row = re.search(r"<tr>\s*<td>budgeted</td>(.*?)</tr>", results, re.DOTALL)
    cells = re.findall(r"<td[^>]*>(.*?)</td>", row[1])
    assert re.fullmatch(r"-?[\d.]+", cells[0])
    assert re.fullmatch(r"\[\S+, \S+\]", cells[1])
    assert len(cells) == 7


@needs_mkdocs
def test_search_works_from_a_file(pages):
    """Typed into the box of a page that was opened from a file, in a folder of the site, too; nothing is loaded."""
    playwright = pytest.importorskip("playwright.sync_api", reason="drives the browser")
    if chromium_program() is None:
        pytest.skip("no Chromium here (Debian: apt-get install chromium)")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium_program(), args=["--no-sandbox"])
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
        for name in (
            "index.html",
            "results.html",
            "parameters.html",
            "validation.html",
            "api/index.html",
        ):
            page.set_viewport_size({"width": 390, "height": 844})
            page.goto(next(path for path in pages if str(path).endswith(name)).as_uri())
            assert page.evaluate("document.documentElement.scrollWidth") <= 390, name
        browser.close()
    assert not wrong


@needs_mkdocs
def test_reference_has_every_public_name(pages):
    """What `medjax` and its subpackages export is in the API reference."""
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
    """`python -m docs.figures` draws the figures that are committed, and the pages show all of them."""
    pytest.importorskip("matplotlib", reason="matplotlib missing: pip install -e '.[train]'")
    from docs.figures.__main__ import draw

    names = {path.name for path in draw(tmp_path)}
    text = "".join(page.read_text(encoding="utf-8") for page in (ROOT / "docs").glob("*.md"))
    for name in names:
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
        assert (ROOT / "docs/images" / name).is_file()
        assert f"images/{name}" in text


def test_every_picture_is_shown():
    """No picture lies about that no page shows."""
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    text = "".join(page.read_text(encoding="utf-8") for page in pages)
    pictures = {path.name for path in (ROOT / "docs/images").iterdir()}
    assert not [name for name in pictures if f"images/{name}" not in text]
