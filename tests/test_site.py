"""The documentation site: it builds without a warning, is complete, and needs no network."""

import re
from pathlib import Path
from urllib.parse import unquote

import pytest
from conftest import python

from stewart_drake import Scenario

DOCS = Path(__file__).parent.parent / "docs"


@pytest.mark.long
def test_the_site_builds_without_warnings_and_needs_no_network(tmp_path):
    pytest.importorskip("myst_nb")
    html = tmp_path / "html"
    python("-m", "sphinx", "-E", "-W", "--keep-going", "-q", "-d", tmp_path / "doctrees", DOCS, html)
    outside = r"""<(?:script|img|iframe)[^>]*\ssrc=["'](?:https?:)?//|<link[^>]*href=["']https?://"""
    dead = []
    for page in html.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert not re.search(outside, text), page
        links = (link for link in re.findall(r'href="([^"#?:]+)["#?]', text) if "{" not in link)
        dead += [(page.name, link) for link in links if not (page.parent / unquote(link)).exists()]
    assert dead == []
    assert '<iframe class="meshcat" src="meshcat.html"' in (html / "in_drake.html").read_text(encoding="utf-8")
    assert (html / "meshcat.html").stat().st_size > 1e6
    said = (html / "llms.txt").read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)]+)\)", said)
    assert len(links) > 10
    assert [link for link in links if not (html / link).is_file() or not link.endswith(".html")] == []
    assert 'href="llms.txt"' in (html / "index.html").read_text(encoding="utf-8")
    keys = (html / "reference" / "keys.html").read_text(encoding="utf-8")
    assert all(re.search(rf">{name}\b", keys) for name in Scenario.__pydantic_fields__)
