import base64
import json
import math
import re
from html import unescape
from html.parser import HTMLParser
from urllib.parse import unquote

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure as Canvas

from stewart_drake.errors import ConfigurationError
from stewart_drake.paper.report import (
    Figure,
    Section,
    Table,
    Text,
    cell,
    holds,
    to_html,
    to_markdown,
    write_report,
)

PNG = b"\x89PNG\r\n\x1a\n"


def picture(folder, name="curve.png"):
    (folder / "figures").mkdir(exist_ok=True)
    figure = Canvas(figsize=(1.0, 1.0))
    figure.add_subplot().plot([0, 1])
    figure.savefig(folder / "figures" / name)
    return (folder / "figures" / name).read_bytes()


def section(key="one", title="First claim", **changes):
    made = Section(key, title, "The paper says so.", "Holds: 3 of 3.", **changes)
    made.text("Some *words* with `code`.")
    made.table("Errors", ("step [ms]", "error [m]"), [(1, 0.123456), (2.5, None)])
    return made


class Page(HTMLParser):
    """What a reader of the page meets: every attribute that can load something, ids, and the cells of its tables."""

    def __init__(self, page):
        super().__init__()
        self.loaded, self.links, self.ids, self.tables, self.tags = [], [], [], [], []
        self._cell = None
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self.tags.append(tag)
        self.loaded += [values[name] for name in ("src", "srcset", "data", "poster", "action") if name in values]
        if tag == "a":
            self.links.append(values["href"])
        elif "href" in values:
            self.loaded.append(values["href"])
        if "id" in values:
            self.ids.append(values["id"])
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self._cell = ""

    def handle_endtag(self, tag):
        if tag in ("td", "th"):
            self.tables[-1][-1].append(self._cell)
            self._cell = None

    def handle_data(self, data):
        if self._cell is not None:
            self._cell += data


def render(tmp_path, sections, title="A report"):
    write_report(tmp_path, title, "Preface.", sections)
    return Page((tmp_path / "report.html").read_text(encoding="utf-8"))


# --- a section as JSON ---------------------------------------------------------------------------------------------

words = st.text(max_size=20)
plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | st.floats(allow_nan=False, allow_infinity=False) | words,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(words, inner, max_size=3),
    max_leaves=8,
)
tables = st.integers(1, 3).flatmap(
    lambda n: st.builds(
        Table,
        words,
        st.lists(words, min_size=n, max_size=n).map(tuple),
        st.lists(st.lists(words, min_size=n, max_size=n).map(tuple), max_size=3).map(tuple),
    )
)
sections = st.builds(
    Section,
    key=words,
    title=words,
    claim=words,
    verdict=words,
    items=st.lists(st.builds(Text, words) | tables | st.builds(Figure, words, words), max_size=4),
    numbers=st.dictionaries(words, plain, max_size=4),
)


@given(sections)
def test_a_section_comes_back_from_its_json_whole(made):
    assert Section.from_json(made.to_json()) == made


@pytest.mark.parametrize("value", [math.nan, math.inf, [-math.inf], {"deep": np.float64("nan")}, np.zeros(2), {1, 2}])
def test_numbers_that_json_does_not_have_are_refused_when_they_are_kept(value):
    with pytest.raises((ValueError, TypeError)):
        section(numbers={"it": value}).to_json()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "3",
        "{}",
        json.dumps({**json.loads(section().to_json()), "items": [3]}),
        json.dumps({**json.loads(section().to_json()), "items": [{"type": "Video"}]}),
        json.dumps({**json.loads(section().to_json()), "items": [{"type": "Text"}]}),
        json.dumps({**json.loads(section().to_json()), "items": {"type": "Text"}}),
        section().to_json()[:-2],
    ],
)
def test_what_is_no_section_is_told_by_the_errors_that_are_promised(text):
    with pytest.raises((ValueError, KeyError, TypeError)):
        Section.from_json(text)


@pytest.mark.parametrize(
    ("parts", "words"),
    [([True, True], "Holds"), ([True, False], "Holds in part"), ([False, False], "Does not hold"), ([True], "Holds")],
)
def test_a_verdict_begins_with_how_much_of_the_claim_holds(parts, words):
    assert holds(part for part in parts) == words


# --- tables --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "-"),
        (0.123456, "0.1235"),
        (np.float64(2e-7), "2e-07"),
        (1234567, "1234567"),
        ("a|b", "a|b"),
        (True, "True"),
    ],
)
def test_a_cell_reads_as_a_person_would_write_it(value, text):
    assert cell(value) == text


def test_cells_reach_the_reader_as_they_are_whatever_they_hold(tmp_path):
    columns = ("abs |x|", "<b>", "a & b")
    rows = [("1 | 2", "x <y> z", "two\nlines"), ("\\|", "|", "äöü ω² 漢"), ("", "<script>alert(1)</script>", "&lt;")]
    made = Section("k", "Odd | title", "claim", "verdict | with <angle> & pipes")
    made.table("caption", columns, rows)
    page = render(tmp_path, [made])
    overview, table = page.tables
    assert overview[1] == ["Odd | title", "verdict | with <angle> & pipes"]
    assert [len(row) for row in table] == [3] * 4
    assert table[0] == list(columns)
    assert table[1] == ["1 | 2", "x <y> z", "two lines"]
    assert table[2][1:] == ["|", "äöü ω² 漢"]
    assert table[3][:2] == ["", "<script>alert(1)</script>"]
    assert "script" not in page.tags


def test_a_row_that_does_not_fit_its_columns_is_refused_at_once():
    with pytest.raises(ValueError, match=r"table 'Errors': 1 cells under 2 columns"):
        Section("k", "t", "c").table("Errors", ("a", "b"), [("1", "2"), ("3",)])


# --- the page ------------------------------------------------------------------------------------------------------


def test_the_page_holds_its_pictures_and_loads_nothing(tmp_path):
    first, second = picture(tmp_path), picture(tmp_path, "with space (2).png")
    made = section()
    made.figure("A curve [m] over [s]", "curve.png")
    made.figure("Another", "with space (2).png")
    page = render(tmp_path, [made])
    assert len(page.loaded) == 2
    for source, content in zip(page.loaded, (first, second), strict=True):
        kind, data = source.split(",")
        assert kind == "data:image/png;base64"
        assert base64.b64decode(data, validate=True) == content
    assert page.tags.count("img") == 2
    assert not {"script", "link", "iframe", "object"} & set(page.tags)
    text = re.sub(r"base64,[A-Za-z0-9+/=]+", "", (tmp_path / "report.html").read_text())
    assert not re.search(r"https?:|file:|url\(|@import|figures/", text)


def test_every_link_of_the_overview_leads_to_its_section(tmp_path):
    titles = ["Plain", "Odd | `code` & <angle>: (37), (38)?", "Überprüfung, ω_Q / ω_R", "III.D -- data"]
    page = render(tmp_path, [section(str(i), title) for i, title in enumerate(titles)])
    assert [unquote(unescape(link)) for link in page.links] == [f"#{anchor}" for anchor in page.ids]
    assert len(set(page.ids)) == len(titles)
    assert [row[0] for row in page.tables[0][1:]] == [title.replace("`", "") for title in titles]


def test_markdown_and_page_say_the_same(tmp_path):
    picture(tmp_path)
    made = section()
    made.figure("A curve", "curve.png")
    other = section("two", "Second claim")
    render(tmp_path, [made, other])
    markdown, page = (tmp_path / "report.md").read_text(), (tmp_path / "report.html").read_text()
    for text in (markdown, page):
        words = ["A report", "Preface.", "First claim", "The paper says so.", "Holds: 3 of 3.", "0.1235", "A curve"]
        places = [text.index(word) for word in words]
        assert places[0] < places[1] < places[2]
        assert text.rindex("Second claim") > text.index("A curve")
    assert to_markdown("A report", "Preface.", [made, other]) == markdown
    assert to_html(markdown, "A report", tmp_path) == page
    assert "(<figures/curve.png>)" in markdown


def test_the_title_of_the_page_is_escaped(tmp_path):
    render(tmp_path, [section()], title="a < b & {body}")
    assert "<title>a &lt; b &amp; {body}</title>" in (tmp_path / "report.html").read_text().replace("\n", "")


def test_a_missing_picture_is_named_and_the_earlier_report_stays(tmp_path):
    render(tmp_path, [section()])
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    made = section(title="Another")
    made.figure("Gone", "gone.png")
    with pytest.raises(ConfigurationError, match=r"gone\.png.*No such file"):
        write_report(tmp_path, "A report", "", [made])
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_report_into_a_missing_folder_is_refused(tmp_path):
    with pytest.raises(ConfigurationError, match="writable folder"):
        write_report(tmp_path / "no", "A report", "", [section()])


def test_numbers_and_their_units_stay_on_one_line(tmp_path):
    made = Section("k", "K", "c", "v")
    made.table(
        "Unbroken", ("torque [N m]", "at"), [("0.3 (-0.5 %)", "12.5 mm, 3 legs"), ("a\u00a0b", "2.5 s, 3 sides")]
    )
    page = to_html(to_markdown("t", "p", [made]), "t", tmp_path)
    for text in ("torque [N\u00a0m]", "0.3 (-0.5\u00a0%)", "12.5\u00a0mm, 3 legs", "a\u00a0b", "2.5\u00a0s, 3 sides"):
        assert f">{text}</t" in page
