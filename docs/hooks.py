"""What MkDocs does around a build: a clean folder for the code blocks, and their pictures."""

from __future__ import annotations

import os
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


def on_post_build(config: Any) -> None:
    """Pictures are made while the pages are: MkDocs has looked for files before that."""
    for picture in [*MADE.rglob("*.png"), *MADE.rglob("*.html")]:
        target = Path(config["site_dir"]) / "made" / picture.relative_to(MADE)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(picture, target)
