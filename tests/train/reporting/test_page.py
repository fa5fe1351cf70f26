"""The report's page on a phone."""

from train.reporting.page import Section, write_page

PHONE = {"width": 390, "height": 844}


def test_a_wide_table_scrolls_beside_the_names_of_its_rows(browser, tmp_path):
    """The page stays as wide as the screen, a row as high as a line, and the row's name stays in sight."""
    head = ["policy", *(f"column {number}" for number in range(8))]
    rows = [[name, *["[-19.32, 12.08]"] * 8] for name in ("forecast", "none")]
    path = tmp_path / "page.html"
    write_page(path, "Report", ["Of a test."], [Section("Part", "Words.", tables=[[head, *rows]])])
    page = browser.new_page(viewport=PHONE)
    page.goto(path.as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    assert page.locator("tr").nth(1).bounding_box()["height"] < 40
    page.evaluate("document.querySelector('.wide').scrollLeft = 400")
    assert page.evaluate("document.querySelector('.wide').scrollLeft") > 300
    assert page.locator("td").first.bounding_box()["x"] >= 0
    page.close()


def test_the_page_begins_with_the_conclusion_and_fits_a_phone(browser, tmp_path):
    """However long a name is; a term is said to mean something."""
    path = tmp_path / "page.html"
    terms = {"depleted": "with an empty battery.", "x" * 60: "y" * 90}
    write_page(
        path, "Report of " + "long_" * 20, ["All is well."], [Section("A", "B.", terms=terms)]
    )
    page = browser.new_page(viewport=PHONE)
    page.goto(path.as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    assert page.locator("h1 + * p").first.inner_text() == "All is well."
    first = page.locator("dl > *").all_inner_texts()[:2]
    assert first == ["depleted", "with an empty battery."]
    page.close()
