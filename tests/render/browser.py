"""Headless Chromium on a page of the player."""

import contextlib
import shutil
import time

PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


def chromium_program():
    """Path of an installed Chromium; None where there is none."""
    return next(filter(None, map(shutil.which, PROGRAMS)), None)


def until(page, condition, patience_s=20.0):
    """Waits for a condition; Playwright's own way of waiting is an `eval`, which the page forbids."""
    end = time.monotonic() + patience_s
    while not page.evaluate(condition):
        assert time.monotonic() < end, condition
        page.wait_for_timeout(20)


@contextlib.contextmanager
def opened(browser, path, width=1600, height=900, glides=False):
    """A page in a window of that size, loaded; afterwards there must have been no error and no request elsewhere.

    Cameras jump unless it `glides`: on their way pictures are drawn by the processor, for seconds.
    """
    motion = "no-preference" if glides else "reduce"
    context = browser.new_context(
        viewport={"width": width, "height": height}, reduced_motion=motion
    )
    page = context.new_page()
    wrong = []
    page.on("console", lambda message: wrong.append(message.text))
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on(
        "request",
        lambda request: (
            None if request.url.startswith(("file:", "data:")) else wrong.append(request.url)
        ),
    )
    page.goto(path.as_uri())
    until(page, "window.medjaxPlayer !== undefined")
    yield page
    context.close()
    assert wrong == []


def seconds(page):
    return page.evaluate("medjaxPlayer.clock.seconds")


def settle(page):
    """Waits until what was asked for is drawn, and cameras have come to where they glide."""
    page.evaluate(
        "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
    )
    until(page, "medjaxPlayer.views.every(({ behind }) => behind === 0)")


def facts(page):
    """Names and values of the vehicle panel."""
    names = page.locator("#vehicle-panel dt").all_inner_texts()
    return dict(zip(names, page.locator("#vehicle-panel dd").all_inner_texts(), strict=True))
