"""How all figures of reproductions look: a title above, a caption below."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from jaxsim.plots import figure

_SIZE = (6.6, 4.0)
_WIDTH = 118  # characters of a line of the caption


@contextmanager
def panel(path: Path, title: str, caption: str, **options: Any) -> Iterator[Any]:
    """One or more axes with a title above the first and the caption below all."""
    options = {"size": _SIZE, **options}
    with figure(path, **options) as axes:
        first = axes if not isinstance(axes, np.ndarray) else axes.flat[0]
        first.set_title(title)
        yield axes
        # constrained_layout keeps room for a supxlabel, which it does not for free text.
        width = int(_WIDTH * options["size"][0] / _SIZE[0])
        lines = textwrap.fill(caption, width, break_on_hyphens=False)
        first.figure.supxlabel(
            lines, x=0.012, ha="left", fontsize=7.5, color="0.3", linespacing=1.35
        )
