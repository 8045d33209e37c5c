"""``gs command``: an order to a flight that is under way in another terminal."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table
from rich.text import Text
from typer._click.exceptions import NoSuchOption

from groundstation.app.completing import order_words
from groundstation.app.options import JsonOption
from groundstation.app.order_client import ask, flights, runtime_folder
from groundstation.app.output import Output
from groundstation.core.choices import unknown
from groundstation.core.errors import CheckFailed, MissionFailed, UserError
from groundstation.mission.operator import Order, parse_command

_ANSWER_S = 5.0
_CONFIRM = "kill"
_NEGATIVE = re.compile(r"-[0-9.]+")


def command(
    context: typer.Context,
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="ORDER",
            help="hold, resume, return, land all, land 3, kill all, kill 3 5 or silence; in a lead step move 1 0 0.5,"
            " turn -90, scale 1.2, stay or next; for a team that waits start, fix; nothing lists the flights.",
            autocompletion=order_words,
        ),
    ] = None,
    *,
    flight: Annotated[
        str | None, typer.Option(help="Mission, log or process id of the flight, where there are several.")
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Kill without asking back.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Gives an order to a flight in another terminal: of the same user, on the same machine."""
    out = Output(as_json=as_json)
    for word in words or ():
        if word.startswith("-") and not _NEGATIVE.fullmatch(word):
            raise NoSuchOption(word, ctx=context)
    if words and words[0].lower() not in (orders := [order.value for order in Order]):
        raise UserError(f"gs command {words[0]}: {unknown(words[0].lower(), orders)}")
    found, silent = flights(runtime_folder(os.environ, Path.home()))
    if not words:
        _list(out, found, silent)
        return
    path, about = choose_flight(found, silent, flight)
    if silent and flight is None:
        out.console.print(Text(_no_answer(silent), style="bold red"))
    try:
        order = parse_command(" ".join(words), about.get("vehicles") or [1]).text
    except ValueError as error:
        raise UserError(str(error)) from None
    if order.split()[0] == _CONFIRM and not yes:
        _confirm(out, order, str(about.get("mission")))
    try:
        answer = ask(path, {"order": order}, _ANSWER_S)
    except (OSError, ValueError) as error:
        raise CheckFailed(
            f"{order}: flight {about.get('mission')} (process {about.get('pid')}) did not answer within"
            f" {_ANSWER_S:g} s: {error}; whether it was obeyed is not known"
        ) from error
    values = {"mission": about.get("mission"), "log": about.get("log"), **answer}
    for line in answer.get("said") or ():
        out.console.print(Text(f"  {line}"))
    if answer.get("ok"):
        out.console.print(Text(f"{about.get('mission')}: {order}: taken, phase {answer.get('phase')}"))
    out.result(values)
    if not answer.get("ok"):
        raise MissionFailed(f"{about.get('mission')}: {order}: {answer.get('why')}")


def _list(out: Output, found: list[tuple[Path, dict[str, Any]]], silent: Sequence[Path]) -> None:
    table = Table("mission", "phase", "vehicles", "process", "log")
    for _, about in found:
        ids = ", ".join(map(str, about.get("vehicles") or ()))
        table.add_row(
            *(str(about.get(key)) for key in ("mission", "phase")), ids, str(about.get("pid")), str(about.get("log"))
        )
    out.console.print(table if found else "no flight is under way")
    for path in silent:
        out.console.print(Text(_no_answer([path]), style="bold red"))
    out.result({"flights": [about for _, about in found], "silent": [path.stem for path in silent]})


def choose_flight(
    found: list[tuple[Path, dict[str, Any]]], silent: Sequence[Path], wanted: str | None
) -> tuple[Path, dict[str, Any]]:
    """The flight that is meant.

    Raises:
        CheckFailed: there is none, or it does not answer.
        UserError: there are several.
    """
    fitting = [item for item in found if wanted is None or _is_meant(item[1], wanted)]
    if len(fitting) == 1:
        return fitting[0]
    names = "; ".join(
        f"{about.get('mission')}, log {about.get('log')}, process {about.get('pid')}" for _, about in found
    )
    if fitting:
        raise UserError(f"several flights are under way: {names}; choose one with --flight")
    if wanted is not None and any(path.stem == wanted for path in silent):
        raise CheckFailed(f"--flight {wanted}: {_no_answer([Path(wanted)])}; it may be suspended")
    others = [f"there are: {names}"] if names else []
    # A flight that does not answer tells neither mission nor log: it may be the one that is meant.
    others += [f"{_no_answer(silent)}, and may be the one that is meant"] if silent and wanted is not None else []
    if wanted is not None and others:
        raise CheckFailed(f"--flight {wanted}: no such flight answers; {'; '.join(others)}")
    stuck = f"; {_no_answer(silent)}" if silent else ""
    raise CheckFailed(f"no flight of this user is under way on this machine{stuck}")


def _no_answer(silent: Sequence[Path]) -> str:
    numbers = ", ".join(path.stem for path in silent)
    return f"process {numbers} does not answer" if len(silent) == 1 else f"processes {numbers} do not answer"


def _is_meant(about: dict[str, Any], wanted: str) -> bool:
    log = str(about.get("log"))
    return wanted in (about.get("mission"), str(about.get("pid")), log, Path(log).stem) or _same_log(log, wanted)


def _same_log(log: str, wanted: str) -> bool:
    """Whether a name means a log, with its suffix or without."""
    names = {wanted, f"{wanted}.tlog"}
    return Path(log).name in names or log in {str(Path(name).resolve()) for name in names}


def _confirm(out: Output, order: str, mission: str) -> None:
    """Asks back before motors stop.

    Raises:
        UserError: nobody can be asked, or the answer is another.
    """
    if not sys.stdin.isatty():
        raise UserError(f"{order}: stops motors in the air; add --yes where nobody can be asked")
    out.console.print(Text(f"{mission}: {order}: motors stop, vehicles fall. Type {_CONFIRM} and Enter:"), end=" ")
    try:
        typed = sys.stdin.readline().strip().lower()
    except KeyboardInterrupt:
        typed = ""
    if typed != _CONFIRM:
        raise UserError(f"{order}: not confirmed, nothing was done")
