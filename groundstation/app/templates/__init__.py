"""Pages of HTML: no script, no resource from elsewhere. What stands in a page is escaped where it is put in."""

from __future__ import annotations

from pathlib import Path

from groundstation.app.picture_style import INK, LINE


def render(template: str, **values: object) -> str:
    """Fills in a page.

    Args:
        template: name of a file beside this.
        values: what it shows, as text; every page has a ``title``.

    Raises:
        jinja2.UndefinedError: the page shows something that was not given.
    """
    import jinja2  # noqa: PLC0415 - only pages need it

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
    )
    return environment.get_template(template).render(ink=INK, line=LINE, **values)
