"""What MkDocs does around a build: a clean folder for the code blocks, and their pictures."""

from __future__ import annotations

import os
import re
import shutil
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
# The code blocks run here (`workdir` in the pages); the examples are run before, by the Makefile.
MADE = ROOT / "results" / "docs"


def on_startup(**_: Any) -> None:
    """Blocks find the command of this environment, and an empty folder."""
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    os.environ["COLUMNS"] = "96"
    shutil.rmtree(MADE / "blocks", ignore_errors=True)
    (MADE / "blocks").mkdir(parents=True)
    # bash reads this file first: a block stops at its first error, in a pipe as well.
    strict = MADE / "strict.sh"
    strict.write_text("set -eo pipefail\n", "utf-8")
    os.environ["BASH_ENV"] = str(strict)


def on_post_build(config: Any) -> None:
    """Pictures are made while the pages are: MkDocs has looked for files before that.

    Raises: FileNotFoundError for one that a page shows and no block has made.
    """
    site = Path(config["site_dir"])
    for made in [*MADE.rglob("*.png"), *MADE.rglob("*.html")]:
        target = site / "made" / made.relative_to(MADE)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(made, target)
    for page in site.rglob("*.html"):
        for link in re.findall(r'(?:src|href)="((?:\.\./)*made/[^"]+)"', page.read_text("utf-8")):
            if not (page.parent / link).is_file():
                raise FileNotFoundError(f"{page.relative_to(site)} shows {link}: nothing made it")
