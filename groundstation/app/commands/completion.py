"""``gs completion``: what makes a shell complete commands and options."""

from __future__ import annotations

from typing import Annotated

import typer
import typer.completion as typer_completion
from typer._completion_shared import get_completion_script

from groundstation.app.completing import choice
from groundstation.app.output import print_text
from groundstation.core.choices import unknown
from groundstation.core.errors import UserError

install_completion = typer_completion.completion_init  # type: ignore[attr-defined] # as typer itself imports it
"""Teaches typer the shells that it knows."""
COMPLETE_VARIABLE = "_GS_COMPLETE"
"""Environment variable by which a shell asks how a line could go on."""
_SHELLS = "bash", "zsh", "fish"


def completion(
    shell: Annotated[str, typer.Argument(help="bash, zsh or fish.", autocompletion=choice(*_SHELLS))],
) -> None:
    """Prints a shell's completion script, for both names of the program.

    bash: source <(gs completion bash) in ~/.bashrc. zsh: the same in ~/.zshrc, after compinit.
    fish: gs completion fish > ~/.config/fish/completions/gs.fish
    """
    if shell not in _SHELLS:
        raise UserError(f"gs completion {shell}: {unknown(shell, _SHELLS)}")
    for name in ("gs", "groundstation"):
        print_text(get_completion_script(prog_name=name, complete_var=COMPLETE_VARIABLE, shell=shell))
