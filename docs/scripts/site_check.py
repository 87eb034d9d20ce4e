"""Links of a built site that lead nowhere: pages, files, pictures and anchors, in raw HTML too. `conf.py` calls it."""

import re
from pathlib import Path
from urllib.parse import unquote, urlsplit

LINK = re.compile(r"""<(?:a|area|link|img|script|iframe|source|video)\b[^>]*?\s(?:href|src)=["']([^"']*)["']""")
ANCHOR = re.compile(r"""<[^>]*?\s(?:id|name)=["']([^"']+)["']""")


def dead_links(site: Path, made: tuple[str, ...] = ()) -> list[str]:
    """Page and link, for every link to what the site does not have. Links on the pages `made` are not checked."""
    texts = {page.resolve(): page.read_text(encoding="utf-8") for page in sorted(site.rglob("*.html"))}
    anchors = {page: set(ANCHOR.findall(text)) for page, text in texts.items() if page.name not in made}
    dead = []
    for page in anchors:
        for link in sorted(set(LINK.findall(texts[page]))):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            anchor = unquote(parts.fragment)
            if not target.is_file() or (anchor and target in anchors and anchor not in anchors[target]):
                dead.append(f"{page.relative_to(site.resolve())}: {link}")
    return dead
