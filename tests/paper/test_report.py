import base64
import math
import re
from html import unescape
from html.parser import HTMLParser
from urllib.parse import unquote

import jinja2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure as Canvas

from stewart_drake.errors import ConfigurationError
from stewart_drake.paper.rendering import (
    cell,
    environment,
    formatted,
    quantiles,
    render,
    row,
    tidy,
    without_tag_lines,
)
from stewart_drake.paper.report import Section, to_html, to_markdown, write_report
from stewart_drake.paper.reproduce import SECTIONS

BODY = tidy("Some *words*\nwith `code`.\n\n*Errors*\n\n| step [ms] | error [m] |\n| 1 | 0.1235 |\n| 2.5 | - |", {})


def picture(folder, name="curve.png"):
    (folder / "figures").mkdir(exist_ok=True)
    figure = Canvas(figsize=(1.0, 1.0))
    figure.add_subplot().plot([0, 1])
    figure.savefig(folder / "figures" / name)
    return (folder / "figures" / name).read_bytes()


def section(key="one", title="First claim", body=BODY, **changes):
    return Section(key, title, "The paper says so.", "Holds: 3 of 3.", body, **changes)


def showing(caption, file):
    return tidy(f"![{caption}](it)", {"it": file})


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


def render_page(tmp_path, sections, title="A report"):
    write_report(tmp_path, title, "Preface.", sections)
    return Page((tmp_path / "report.html").read_text(encoding="utf-8"))


# --- a section as JSON ---------------------------------------------------------------------------------------------

words = st.text(max_size=20)
plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | st.floats(allow_nan=False, allow_infinity=False) | words,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(words, inner, max_size=3),
    max_leaves=8,
)
sections = st.builds(
    Section, *[words] * 5, numbers=st.dictionaries(words, plain, max_size=4), files=st.lists(words, max_size=2)
)


@given(sections)
def test_a_section_comes_back_from_its_json_whole(made):
    assert Section.from_json(made.to_json()) == made


@pytest.mark.parametrize("value", [math.nan, math.inf, [-math.inf], {"deep": np.float64("nan")}, np.zeros(2), {1, 2}])
def test_numbers_that_json_does_not_have_are_refused_when_they_are_kept(value):
    with pytest.raises((ValueError, TypeError)):
        section(numbers={"it": value}).to_json()


@pytest.mark.parametrize("text", ["", "{", "[]", "3", "{}", '{"key": "k"}', section().to_json()[:-2]])
def test_what_is_no_section_is_told_by_the_errors_that_are_promised(text):
    with pytest.raises((ValueError, TypeError)):
        Section.from_json(text)


# --- templates -----------------------------------------------------------------------------------------------------


@pytest.fixture
def of_template(monkeypatch):
    """Renders a text as the body of a template."""

    def of(text, figures=None, **values):
        made = environment().from_string("{% block body %}" + without_tag_lines(text) + "{% endblock %}")
        monkeypatch.setattr(jinja2.Environment, "get_template", lambda *_: made)
        return render("any", "body", figures, **values)

    return of


@pytest.mark.parametrize("key", [*SECTIONS, "report"])
def test_every_template_has_its_blocks(key):
    wanted = {"title", "preface"} if key == "report" else {"title", "claim", "verdict", "body"}
    assert wanted <= set(environment().get_template(f"{key}.md.j2").blocks)
    assert len(render(key, "title").split("\n")) == 1


def test_no_two_sections_show_one_picture():
    sources = [environment().loader.get_source(environment(), f"{key}.md.j2")[0] for key in SECTIONS]
    names = [name for source in sources for name in re.findall(r"!\[[^\]]*\]\(([^)]*)\)", source)]
    assert len(names) == len(set(names)) >= 10


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "-"), (0.123456, "0.1235"), (np.float64(2e-7), "2e-07"), (1234567, "1234567"), ("a|b", "a|b")],
)
def test_a_value_reads_as_a_person_would_write_it(of_template, value, text):
    assert cell(value) == of_template("{{ it }}", it=value) == text


def test_numbers_are_formatted_with_a_scale_and_a_dash_for_nothing():
    assert formatted(0.0123, ".1f", 1e3) == "12.3"
    assert formatted(None, ".1f", 1e3) == "-"
    assert quantiles([1e-13, 2e-3, 0.5], ".3g", 1e3, 1e-11) == "0 / 2 / 500"
    assert quantiles([], ".3g") == "-"


def test_paragraphs_points_and_tables_come_out_on_their_lines(of_template):
    text = """
One paragraph{% if long %} on
two lines{% endif %}
{% for name in names %}
{{ name }}{{ "." if loop.last else "," }}
{% endfor %}


- a point
  that goes on
- another

| a | b |
{% for name in names %}
| {{ name }} | {{ loop.index }} |
{% endfor %}
"""
    found = of_template(text, long=True, names=["x", "y"]).split("\n\n")
    assert found == [
        "One paragraph on two lines x, y.",
        "- a point that goes on\n- another",
        "| a | b |\n|---|---|\n| x | 1 |\n| y | 2 |",
    ]


def test_a_row_that_does_not_fit_its_columns_is_refused_at_once():
    with pytest.raises(ValueError, match=r"1 cells under 2 columns: \| 3 \|"):
        tidy("| a | b |\n| 1 | 2 |\n| 3 |", {})


def test_a_template_that_speaks_of_what_is_not_given_is_an_error(of_template):
    with pytest.raises(jinja2.UndefinedError, match="missing"):
        of_template("{{ missing }}")
    with pytest.raises(KeyError, match="curve"):
        of_template("![A curve](curve)")


def test_cells_reach_the_reader_as_they_are_whatever_they_hold(tmp_path):
    columns = ("abs |x|", "<b>", "a & b")
    rows = [("1 | 2", "x <y> z", "two\nlines"), ("\\|", "|", "äöü ω² 漢"), ("", "<script>alert(1)</script>", "&lt;")]
    body = tidy("\n".join(row(*cells) for cells in (columns, *rows)), {})
    page = render_page(tmp_path, [Section("k", "Odd | title", "claim", "verdict | with <angle> & pipes", body)])
    overview, table = page.tables
    assert overview[1] == ["Odd | title", "verdict | with <angle> & pipes"]
    assert [len(row) for row in table] == [3] * 4
    assert table[0] == list(columns)
    assert table[1] == ["1 | 2", "x <y> z", "two lines"]
    assert table[2][1:] == ["|", "äöü ω² 漢"]
    assert table[3][:2] == ["", "<script>alert(1)</script>"]
    assert "script" not in page.tags


# --- the page ------------------------------------------------------------------------------------------------------


def test_the_page_holds_its_pictures_and_loads_nothing(tmp_path):
    first, second = picture(tmp_path), picture(tmp_path, "with space (2).png")
    body = showing("A curve [m] over [s]", "curve.png") + "\n\n" + showing("Another", "with space (2).png")
    page = render_page(tmp_path, [section(body=body)])
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
    page = render_page(tmp_path, [section(str(i), title) for i, title in enumerate(titles)])
    assert [unquote(unescape(link)) for link in page.links] == [f"#{anchor}" for anchor in page.ids]
    assert len(set(page.ids)) == len(titles)
    assert [row[0] for row in page.tables[0][1:]] == [title.replace("`", "") for title in titles]


def test_markdown_and_page_say_the_same(tmp_path):
    picture(tmp_path)
    made = section(body=BODY + "\n\n" + showing("A curve", "curve.png"))
    other = section("two", "Second claim")
    render_page(tmp_path, [made, other])
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
    render_page(tmp_path, [section()], title="a < b & {body}")
    assert "<title>a &lt; b &amp; {body}</title>" in (tmp_path / "report.html").read_text().replace("\n", "")


def test_a_missing_picture_is_named_and_the_earlier_report_stays(tmp_path):
    render_page(tmp_path, [section()])
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    made = section(title="Another", body=showing("Gone", "gone.png"))
    with pytest.raises(ConfigurationError, match=r"gone\.png.*No such file"):
        write_report(tmp_path, "A report", "", [made])
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_numbers_and_their_units_stay_on_one_line(tmp_path):
    rows = [("torque [N m]", "at"), ("0.3 (-0.5 %)", "12.5 mm, 3 legs"), ("a\u00a0b", "2.5 s, 3 sides")]
    made = Section("k", "K", "c", "v", tidy("\n".join(row(*cells) for cells in rows), {}))
    page = to_html(to_markdown("t", "p", [made]), "t", tmp_path)
    for text in ("torque [N\u00a0m]", "0.3 (-0.5\u00a0%)", "12.5\u00a0mm, 3 legs", "a\u00a0b", "2.5\u00a0s, 3 sides"):
        assert f">{text}</t" in page
