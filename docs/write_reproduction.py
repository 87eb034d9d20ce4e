"""Writes docs/results/reproduction.md, the report on the paper without its pictures: `make reproduction`.

python docs/write_reproduction.py runs/reproduction     # a folder that `stewart-drake reproduce` made
"""

import json
import re
import sys
from pathlib import Path

NOTE = "`stewart-drake reproduce` at full size; its pictures are in the page that it writes and are left out here."
PICTURE = re.compile(r"\n!\[.*\]\(<figures/[^>]+>\)\n\n\*.*\*\n")


def main(folder: Path) -> None:
    """Writes the text; ends with a line where the report is a quick one."""
    if json.loads((folder / "report.json").read_text())["quick"]:
        sys.exit(f"{folder}: a quick report; call stewart-drake reproduce without --quick")
    title, _, rest = PICTURE.sub("", (folder / "report.md").read_text()).partition("\n")
    Path(__file__).with_name("results").joinpath("reproduction.md").write_text(f"{title}\n\n{NOTE}\n{rest}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
