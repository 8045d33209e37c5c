"""``make docs``: draws pages and figures from the program, then builds the site strictly."""

from __future__ import annotations

import sys

from tests.docs.figures import draw
from tests.docs.pages import PAGES
from tests.docs.site import ROOT, build_site

for page, text in PAGES.items():
    (ROOT / page).write_text(text(), encoding="utf-8")
draw(ROOT / "docs" / "img")
sys.exit(build_site())
