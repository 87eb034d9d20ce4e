"""The run of notebooks/07_in_drake.ipynb as Meshcat recorded it: the site's build makes it, and this script a still.

`python docs/draw_meshcat.py` draws docs/images/meshcat.png, by Debian's chromium.
"""

import json
import subprocess
import tempfile
from pathlib import Path

DOCS = Path(__file__).parent
NOTEBOOK = DOCS.parent / "notebooks" / "07_in_drake.ipynb"
CHROMIUM = ("chromium", "--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


def recording() -> str:
    """The page of Meshcat, one file without a network: the notebook's code up to its recording."""
    names: dict = {}
    for cell in json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] == "code":
            exec("".join(line for line in cell["source"] if not line.startswith("%")), names)
            if any("PublishRecording" in line for line in cell["source"]):
                break
    return names["meshcat"].StaticHtml()


def main():
    """Draws the still, some seconds into the recording."""
    picture = DOCS / "images" / "meshcat.png"
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "meshcat.html"
        page.write_text(recording(), encoding="utf-8")
        view = ("--hide-scrollbars", "--window-size=1000,560", "--virtual-time-budget=8000")
        subprocess.run([*CHROMIUM, *view, f"--screenshot={picture}", page.as_uri()], check=True, capture_output=True)


if __name__ == "__main__":
    main()
