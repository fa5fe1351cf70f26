"""Headless Chromium on a page of the player."""

import contextlib
import shutil
import time

PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
RESET = """() => {
  const player = medjaxPlayer;
  player.pause();
  player.select(0, null);
  player.setCamera("auto");
  player.setZoom(0);
  player.setSpeed(1);
  player.setColouring("charge");
  player.seek(0);
}"""


def chromium_program():
    """Path of an installed Chromium, or None."""
    return next(filter(None, map(shutil.which, PROGRAMS)), None)


def until(page, condition, patience_s=20.0):
    """Waits for a condition; Playwright's own wait is an `eval`, which the page forbids."""
    end = time.monotonic() + patience_s
    while not page.evaluate(condition):
        assert time.monotonic() < end, condition
        page.wait_for_timeout(20)


@contextlib.contextmanager
def opened(browser, path, width=1600, height=900):
    """A loaded page of that size; fails afterwards if it had an error or requested anything from elsewhere.

    Its cameras jump: a glide takes seconds, because the processor draws the pictures.
    """
    size = {"width": width, "height": height}
    context = browser.new_context(viewport=size, reduced_motion="reduce")
    page = context.new_page()
    wrong = []
    page.on("console", lambda message: wrong.append(message.text))
    page.on("pageerror", lambda error: wrong.append(str(error)))
    own = ("file:", "data:")
    page.on("request", lambda each: each.url.startswith(own) or wrong.append(each.url))
    page.goto(path.as_uri())
    until(page, "window.medjaxPlayer !== undefined")
    yield page
    context.close()
    assert wrong == []


@contextlib.contextmanager
def shared_pages(browser):
    """Yields a function that opens each page once and resets it for each test; cameras may glide afterwards."""
    with contextlib.ExitStack() as stack:
        known = {}

        def page_of(path, glides=False):
            if path not in known:
                known[path] = stack.enter_context(opened(browser, path))
            page = known[path]
            page.emulate_media(reduced_motion="reduce")
            page.evaluate(RESET)
            settle(page)
            if glides:
                page.emulate_media(reduced_motion="no-preference")
            return page

        yield page_of


def seconds(page):
    return page.evaluate("medjaxPlayer.clock.seconds")


def settle(page):
    """Waits until the page is drawn and the camera has stopped gliding."""
    page.evaluate(
        "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
    )
    until(page, "medjaxPlayer.gaze.behind === 0")


def facts(page):
    """Names and values of the vehicle panel."""
    names = page.locator("#vehicle-panel dt").all_inner_texts()
    return dict(zip(names, page.locator("#vehicle-panel dd").all_inner_texts(), strict=True))
