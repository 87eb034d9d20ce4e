"""The documentation site: it builds without a warning, is complete, and needs no network."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from stewart_drake import Scenario

DOCS = Path(__file__).parent.parent / "docs"


@pytest.mark.long
def test_the_site_builds_without_warnings_and_needs_no_network(tmp_path):
    pytest.importorskip("myst_nb")
    html = tmp_path / "html"
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-E",
        "-W",
        "--keep-going",
        "-q",
        "-d",
        tmp_path / "doctrees",
        DOCS,
        html,
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, "LC_ALL": "C.UTF-8"})
    assert done.returncode == 0, done.stderr
    for page in html.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert not re.search(
            r"""<(?:script|img|iframe)[^>]*\ssrc=["'](?:https?:)?//|<link[^>]*href=["']https?://""", text
        ), page
    keys = (html / "reference" / "keys.html").read_text(encoding="utf-8")
    assert all(re.search(rf">{name}\b", keys) for name in Scenario.__pydantic_fields__)
