"""The command line: one typer application, one place where errors end.

A ``UserError`` is printed as its message and ends with its exit code; wrong usage ends with 2.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from importlib import import_module

import typer
from rich.console import Console
from rich.text import Text
from typer._click.exceptions import ClickException, MissingParameter, NoArgsIsHelpError, NoSuchOption

from groundstation.app.commands.completion import COMPLETE_VARIABLE, install_completion
from groundstation.app.output import Output, SteadyConsole, flush_streams, hold_streams
from groundstation.app.reference.examples import EXAMPLES
from groundstation.app.stopped import STOPPED, STOPPED_WORDS
from groundstation.core.choices import nearest, unknown
from groundstation.core.errors import UserError
from groundstation.core.findings import words_for

COMMANDS: dict[str, tuple[str, str]] = {
    "missions": ("start", "List the missions that come along."),
    "init": ("start", "Make a folder with a mission of your own to begin with."),
    "new": ("new", "Make a formation file from a shape or from points."),
    "fly": ("fly", "Fly a mission on vehicles, or as a dry run on the emulator."),
    "command": ("command", "Give an order to a flight in another terminal: hold, return, land, kill."),
    "console": ("console", "Show a flight in a browser, and give orders there."),
    "vehicles": ("vehicles", "Find the vehicles on links; prints a block for a mission file."),
    "check": ("fly", "Check a mission and its vehicles on their pads; arm nothing."),
    "params": ("params", "Keep the parameters of a mission's vehicles, compare them, give them back."),
    "signing": ("signing", "Make a key that MAVLink frames are signed with, give it to vehicles."),
    "design": ("design", "Design the gains of a formation."),
    "sitl": ("sitl", "Run emulated vehicles for any ground station."),
    "gateway": ("gateway", "Serve Crazyflies as MAVLink vehicles to any ground station."),
    "mocap": ("mocap", "Send frames of a motion capture system to flights: read, faked, or played."),
    "sitl-env": ("sitl_env", "Print the lines that start a mission's team on the autopilots' own simulators."),
    "replay": ("replay", "Look at a log, stream it, or verify it bit by bit."),
    "report": ("report", "Draw the pictures of a log."),
    "compare": ("compare", "Compare several flights: figures, and pictures over each other."),
    "export": ("export", "Write a log for other programs: Parquet, CSV, MCAP."),
    "import": ("import_", "Turn another program's recorded flight into a log."),
    "campaign": ("campaign", "Fly a mission many times over random starts and faults, and sum up."),
    "identify": ("identify", "Find lag and delay of each vehicle's velocity loop in a log."),
    "schema": ("schema", "Print the JSON schema of mission, formation or campaign files, for editors."),
    "completion": ("completion", "Print what makes a shell complete gs: bash, zsh or fish."),
    "bench": ("bench", "Measure speed, as ratios in one run."),
}
"""Command name: module in ``groundstation.app.commands``, help for the overview."""

_NAMES_FILE = ("-o", "--output", "--log", "--picture", "--graph-file", "--file", "-f")
"""Options that name a file or a folder; an empty name would stand for the folder one is in."""


def refuse_empty_names(arguments: Sequence[str]) -> None:
    """Makes sure that no option that names a file or a folder is followed by nothing.

    Raises:
        UserError: names the option.
    """
    for number, option in enumerate(arguments):
        value = arguments[number + 1] if number + 1 < len(arguments) else None
        name = option.removesuffix("=")
        if name in _NAMES_FILE and (name != option or value == ""):
            raise UserError(f"{name}: its name is empty; name a file, or a folder where it takes one")


def _nothing() -> None:
    """Stands for a command that was not called, in the overview."""


def build(called: str | None) -> typer.Typer:
    """Builds the application.

    Only the module of the command that is called is loaded, so that ``gs fly`` does not wait for matplotlib.

    Args:
        called: name of the command on the command line, None for the overview.
    """
    application = typer.Typer(
        name="gs",
        help="Ground station that flies teams of multirotors into 3D formations. gs --version tells the version.",
        add_completion=False,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )
    for name, (module_name, overview) in COMMANDS.items():
        function = _nothing
        if name == called:
            module = import_module(f"groundstation.app.commands.{module_name}")
            function = getattr(module, "import_" if name == "import" else name.replace("-", "_"))
        examples = "example: " + "; ".join(EXAMPLES[name]) if name == called else None
        settings = {"ignore_unknown_options": True} if name == "command" else None  # `move -1 0 0`: numbers, no options
        application.command(
            name=name, help=None if name == called else overview, epilog=examples, context_settings=settings
        )(function)
    return application


def words_to_complete() -> list[str]:
    """What stands after the program's name where a shell asks how it goes on; empty otherwise."""
    if COMPLETE_VARIABLE not in os.environ:
        return []
    install_completion()
    line = os.environ.get("_TYPER_COMPLETE_ARGS") or os.environ.get("COMP_WORDS", "")
    return line.split()[1:]


def usage_words(error: ClickException) -> str:
    """What is wrong with the words on the command line: option, value, what is allowed; and where to look it up."""
    parameter, context = getattr(error, "param", None), getattr(error, "ctx", None)
    names = [*getattr(parameter, "opts", ())]
    name = max(names, key=len) if names else ""
    name = name if name.startswith("-") else name.upper()
    findings = getattr(error.__cause__, "errors", None)
    if findings is not None:  # typer's values are judged by pydantic
        words = f"{name}: {words_for(findings())}"
    elif isinstance(error, MissingParameter):
        about = (getattr(parameter, "help", None) or "").rstrip(".")
        words = f"{name}: is missing" + (f": {about[:1].lower()}{about[1:]}" if about else "")
    elif isinstance(error, NoSuchOption):
        known = [] if context is None else [item for one in context.command.params for item in one.opts]
        near = nearest(error.option_name, [item for item in known if item.startswith("--")])
        words = f"{error.option_name}: unknown option" + (f", did you mean {near}?" if near else "")
    else:
        words = error.format_message().rstrip(".")
        words = words[:1].lower() + words[1:]
    help_of = "gs" if context is None else context.command_path
    return f"{words}{'' if words.endswith('?') else ';'} {help_of} --help lists what it takes"


def _answer(arguments: list[str], words: str, exit_code: int) -> None:
    """Gives a program that asked for JSON its object, where the command could not."""
    if "--json" in arguments:
        Output(as_json=True).result({"error": words, "exit_code": exit_code})


def main() -> None:
    """Entry point of ``gs``."""
    hold_streams()
    arguments = sys.argv[1:]
    if arguments == ["--version"]:
        from groundstation.app.about import version_words  # noqa: PLC0415 - asks git

        Console(highlight=False).print(version_words(), markup=False)
        return
    called = next((argument for argument in arguments or words_to_complete() if not argument.startswith("-")), None)
    try:
        if called is not None and called not in COMMANDS and COMPLETE_VARIABLE not in os.environ:
            raise UserError(f"gs {called}: {unknown(called, COMMANDS)}")
        refuse_empty_names(arguments)
        ended = build(called)(args=arguments, prog_name="gs", complete_var=COMPLETE_VARIABLE, standalone_mode=False)
        if ended == STOPPED:
            sys.stderr.write(STOPPED_WORDS)
            _answer(arguments, STOPPED_WORDS.removeprefix("gs: ").strip(), STOPPED)
        if isinstance(ended, int) and ended:  # commands return nothing; this is what typer ended with
            sys.exit(ended)
    except ClickException as error:  # words on the command line that are none
        if isinstance(error, NoArgsIsHelpError):
            error.show()
        else:
            words = usage_words(error)
            SteadyConsole(stderr=True, soft_wrap=True).print(Text(f"gs: {words}"))
            _answer(arguments, words, error.exit_code)
        sys.exit(error.exit_code)
    except UserError as error:
        SteadyConsole(stderr=True, soft_wrap=True).print(Text(f"gs: {error}"))
        if not error.answered:
            _answer(arguments, str(error), error.exit_code)
        sys.exit(error.exit_code)
    finally:
        flush_streams()
