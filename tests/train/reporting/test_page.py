"""The report's page on a phone."""

from train.reporting.page import Section, write_page

PHONE = {"width": 390, "height": 844}


def test_a_wide_table_scrolls_beside_the_names_of_its_rows(browser, tmp_path):
    """The page stays as wide as the screen, a row as high as a line, and the row's name stays in sight."""
    head = ["policy", *(f"column {number}" for number in range(8))]
    rows = [[name, *["[-19.32, 12.08]"] * 8] for name in ("forecast", "none")]
    path = tmp_path / "page.html"
    write_page(path, "Report", "Of a test.", [Section("Part", "Words.", tables=[[head, *rows]])])
    page = browser.new_page(viewport=PHONE)
    page.goto(path.as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    assert page.locator("tr").nth(1).bounding_box()["height"] < 40
    page.evaluate("document.querySelector('.wide').scrollLeft = 400")
    assert page.evaluate("document.querySelector('.wide').scrollLeft") > 300
    assert page.locator("td").first.bounding_box()["x"] >= 0
    page.close()
