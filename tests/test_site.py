"""The documentation site: it builds without a warning, which a dead link is too, is complete, and needs no network."""

import os
import re
import shutil
from pathlib import Path

import pytest
import site_check
from conftest import python

from stewart_drake import Scenario

DOCS = Path(__file__).parent.parent / "docs"


@pytest.fixture(scope="module")
def html(tmp_path_factory):
    """The site, built with warnings as errors."""
    pytest.importorskip("myst_nb")
    pytest.importorskip("ziglang")
    python(DOCS / "scripts" / "tab.py")
    folder = tmp_path_factory.mktemp("site")
    python("-m", "sphinx", "-E", "-W", "--keep-going", "-q", "-d", folder / "doctrees", DOCS, folder / "html")
    return folder / "html"


@pytest.mark.long
@pytest.mark.xdist_group("site")
def test_the_site_builds_without_warnings_and_needs_no_network(html):
    outside = r"""<(?:script|img|iframe)[^>]*\ssrc=["'](?:https?:)?//|<link[^>]*href=["']https?://"""
    for page in html.rglob("*.html"):
        assert not re.search(outside, page.read_text(encoding="utf-8")), page
    assert '<iframe class="meshcat" src="meshcat.html"' in (html / "in_drake.html").read_text(encoding="utf-8")
    assert (html / "meshcat.html").stat().st_size > 1e6
    said = (html / "llms.txt").read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)]+)\)", said)
    assert len(links) > 10
    assert [link for link in links if not (html / link).is_file() or not link.endswith(".html")] == []
    assert 'href="llms.txt"' in (html / "index.html").read_text(encoding="utf-8")
    keys = (html / "reference" / "keys.html").read_text(encoding="utf-8")
    assert all(re.search(rf">{name}\b", keys) for name in Scenario.__pydantic_fields__)


@pytest.mark.long
@pytest.mark.xdist_group("site")
def test_tables_fit_a_page(html):
    chromium = shutil.which("chromium")
    if chromium is None and "CI" not in os.environ:
        pytest.skip("needs Chromium")
    from playwright.sync_api import sync_playwright

    wide = "[...document.querySelectorAll('.table-wrapper')].map(each => each.scrollWidth - each.clientWidth)"
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        found = 0
        for path in [*html.glob("*.html"), *html.glob("results/*.html")]:
            page.goto(path.as_uri())
            excess = page.evaluate(wide)
            assert all(pixels <= 2 for pixels in excess), (path.name, excess)
            found += len(excess)
        browser.close()
    assert found > 40


def test_a_link_to_nowhere_is_found_in_raw_html_too(tmp_path):
    (tmp_path / "data").mkdir()
    for name in ("data/points.csv", "made.html"):
        (tmp_path / name).write_text('<a href="gone">')
    (tmp_path / "other.html").write_text('<h2 id="here">Here</h2><a href="index.html">')
    right = [
        "data/points.csv",
        "other.html#here",
        "#top",
        "#",
        "made.html?x=1#any",
        "https://example.org/x",
        "mailto:a@b",
    ]
    wrong = ["data/points.yaml", "other.html#there", "#bottom", "picture.png", "../outside.c"]
    tags = [f'<a class="x" href="{link}">' for link in right + wrong[:3]]
    tags += [f'<img src="{link}">' for link in wrong[3:]]
    (tmp_path / "index.html").write_text('<p id="top">' + "".join(tags))
    dead = site_check.dead_links(tmp_path, ("made.html",))
    assert sorted(dead) == sorted(f"index.html: {link}" for link in wrong)
