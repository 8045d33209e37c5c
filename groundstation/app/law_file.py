"""``gs new law``: a law of one's own to begin with, a file that flies as it is."""

from __future__ import annotations

from pathlib import Path

from rich.text import Text

from groundstation.app.output import Output
from groundstation.app.point_files import write_new
from groundstation.app.resources import packaged_configs
from groundstation.core.errors import UserError

_TEMPLATE = "my_law"


def new_law(name: str, output: Path | None, out: Output, *, force: bool) -> None:
    """Copies the law that comes along, under a name that Python can load.

    Args:
        name: of the module, with or without ``.py``.
        output: the file; NAME.py in this folder when None.
        out: tells what was made.
        force: replace a file that is there.

    Raises:
        UserError: a name that no module can have, or a file that is there already or cannot be written.
    """
    path = output or Path(name).with_suffix(".py")
    if not path.stem.isidentifier() or path.suffix != ".py":
        raise UserError(
            f"{path}: a law's file is NAME.py, where NAME has letters, digits and _, and begins with no digit"
        )
    template = (packaged_configs() / "laws" / f"{_TEMPLATE}.py").read_text(encoding="utf-8")
    replaced = write_new(path, template.replace(_TEMPLATE, path.stem), force=force)
    use = f"{path.stem}:MyLaw"
    out.console.print(Text(f"{'replaced' if replaced else 'made'} {path}"))
    out.console.print(Text(f"next:  gs fly --mission cube8 --dry-run --set law={use}"))
    out.result({"file": str(path), "use": use})
