"""Sphinx settings of the documentation site: `make docs`. The site needs no network, and no script for formulas."""

import importlib.metadata
import re
import sys
from pathlib import Path

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.util import logging

from stewart_drake.base.config import Section

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS / "scripts"))
import draw_meshcat  # noqa: E402
import reference  # noqa: E402
import site_check  # noqa: E402

project = "stewart-drake"
author = "The stewart-drake developers"
project_copyright = f"{author}, BSD 3-Clause licence"
release = importlib.metadata.version(project)
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build", "**/runs", "**/.ipynb_checkpoints"]
suppress_warnings = ["misc.highlighting_failure"]  # a table of points is marked as csv, for which there is no lexer

html_theme = "furo"
html_title = project
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_extra_path = ["tab.html"]  # `make tab` makes it
html_show_sourcelink = False
html_math_renderer = "mathml"

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "off"  # `make docs` says otherwise
nb_execution_timeout = 600
nb_execution_raise_on_error = True
nb_execution_in_temp = True
nb_merge_streams = True
nb_output_stderr = "remove"  # what libraries say on the way
nb_render_markdown_format = "myst"  # tables

autodoc_member_order = "bysource"
autodoc_inherit_docstrings = False
napoleon_custom_sections = [("Keys", "params_style"), "Deviation"]
napoleon_use_ivar = True
napoleon_use_rtype = False
default_role = "code"


def formula(translator, node):
    """TeX as MathML, which browsers draw themselves; bars are fences, and functions stand apart."""
    display = "block" if isinstance(node, nodes.math_block) else "inline"
    mathml = convert(node.astext(), display=display)
    mathml = re.sub('<mo(?: stretchy="false")?>&#x0007C;', '<mo stretchy="false" lspace="0" rspace="0">|', mathml)
    space = '<mspace width="0.167em"/>'
    mathml = re.sub(r"(?<!<msub>)(?<!<msup>)(<mi>(?:sin|cos|tan|log|atan2|arccos)</mi>)", rf"{space}\1{space}", mathml)
    translator.body.append(mathml)
    raise nodes.SkipNode


def site_links(_app, docname, source):
    """Links that leave docs: notebooks are pages of the site, and any other file has a page that shows it."""
    folder = ((reference.ROOT if docname.startswith("notebooks/") else DOCS) / docname).parent

    def link(match):
        page = reference.page_of((folder / match[1]).resolve())
        return f"](/{page.as_posix()}{match[2] or ''})" if page else match[0]

    source[0] = reference.LINK.sub(link, source[0])
    moving = r'<iframe class="meshcat" src="meshcat.html" title="\1" loading="lazy"></iframe>'
    source[0] = re.sub(r"!\[(.*?)\]\(images/meshcat\.png\)", moving, source[0])


def write_others(app, error):
    """The recording of Meshcat; llms.txt at the root, where assistants look, with links to the site's pages."""
    if error is None and app.builder.format == "html":
        out, text = Path(app.outdir), (DOCS / "llms.txt").read_text(encoding="utf-8")
        (out / "llms.txt").write_text(re.sub(r"(?<=\.)md\)", "html)", text), encoding="utf-8")
        (out / "meshcat.html").write_text(draw_meshcat.recording(), encoding="utf-8")


def check_links(app, error):
    """A link to nowhere is a warning, with which `make docs` fails; Sphinx does not check raw HTML."""
    if error is None and app.builder.format == "html":
        for dead in site_check.dead_links(Path(app.outdir), ("tab.html", "meshcat.html")):
            logging.getLogger("links").warning("%s leads nowhere", dead)


def short_signature(_app, what, _name, section, *_):
    """The keys of a section stand in its text; in a line they help nobody."""
    return ("(**keys)", None) if what == "class" and issubclass(section, Section) else None


def escape_bars(_app, _what, _name, _object, _options, lines):
    """|x| is a magnitude in our texts, and a substitution in Sphinx's."""
    for index, line in enumerate(lines):
        lines[index] = re.sub(r"`[^`]*`|\|", lambda found: r"\|" if found[0] == "|" else found[0], line)


def setup(app):
    """What Sphinx asks of a configuration with code of its own."""
    app.add_object_type("key", "key", "single: %s", objname="YAML key")
    app.add_html_math_renderer("mathml", (formula, None), (formula, None))
    app.connect("builder-inited", lambda _: reference.write_all())
    app.connect("source-read", site_links)
    app.connect("build-finished", write_others)
    app.connect("build-finished", check_links)
    app.connect("autodoc-process-signature", short_signature)
    app.connect("autodoc-process-docstring", escape_bars)
