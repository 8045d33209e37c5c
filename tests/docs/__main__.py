"""``make docs``: draws pages and figures from the program, then builds the site strictly."""

from __future__ import annotations

import sys

from groundstation.app.commands.schema import MODELS, schema_json
from groundstation.app.schema_files import schema_name
from tests.docs.figures import draw
from tests.docs.pages import PAGES
from tests.docs.site import ROOT, build_site

for page, text in PAGES.items():
    (ROOT / page).write_text(text(), encoding="utf-8")
for kind in MODELS:
    (ROOT / "configs" / "schemas" / schema_name(kind)).write_text(schema_json(kind) + "\n", encoding="utf-8")
draw(ROOT / "docs" / "img")
sys.exit(build_site())
