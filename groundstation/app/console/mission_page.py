"""The page on which a mission is made: picked, edited, judged, flown as a dry run, saved. It flies no vehicles."""

from __future__ import annotations

import asyncio
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from nicegui import run, ui
from nicegui.events import ValueChangeEventArguments

from groundstation.app.console.draft import Draft, dumped
from groundstation.app.console.formation_editor import FormationEditor
from groundstation.app.console.mission_form import MissionForm
from groundstation.app.console.naming import named
from groundstation.app.console.recorded import Recorded
from groundstation.app.console.theme import Theme
from groundstation.app.console.view import number
from groundstation.app.packaged import packaged_names
from groundstation.app.resources import find_config
from groundstation.core.errors import UserError
from groundstation.core.files import parse_yaml
from groundstation.records.replay import load_flight

_LINES_SHOWN = 200
_FIGURES = (
    ("formed after", "time_to_form_s", " s"),
    ("largest error while holding", "formation_error_m", " m"),
    ("smallest distance", "min_distance_m", " m"),
    ("safety radius r", "safety_radius_m", " m"),
)


class MissionDesk:
    """What all pages of one mission desk share.

    Args:
        folder: where missions are saved, and looked for besides those that come along.
        first: the mission that is picked at first.

    Attributes:
        flown: the last dry run, to be watched.
    """

    def __init__(self, folder: Path, first: Path) -> None:
        self.folder, self.first = folder, first
        self.flown: Recorded | None = None

    def choices(self) -> list[str]:
        """Missions that can be picked."""
        own = [path.stem for path in sorted(self.folder.glob("*.yaml")) if _looks_like_one(path)]
        return list(dict.fromkeys([str(self.first), *own, *packaged_names("missions")]))


def _looks_like_one(path: Path) -> bool:
    try:
        return "mission.schema.json" in path.read_text(encoding="utf-8", errors="replace")[:200]
    except OSError:
        return False


class MissionPage:
    """One browser's desk.

    Args:
        desk: what all share.
        solid: with the scene in three dimensions.
    """

    def __init__(self, desk: MissionDesk, *, solid: bool) -> None:
        self._desk, self._solid = desk, solid
        self._dark: bool | None = None
        self._draft: Draft | None = None
        self._form: MissionForm | None = None
        self._editor: FormationEditor | None = None
        self._flight: asyncio.subprocess.Process | None = None
        with ui.header().classes("items-center gap-4 py-1"):
            ui.label("missions").classes("text-lg font-bold").props(named("title"))
            ui.space()
            theme = Theme(self._themed)
        with ui.row().classes("w-full items-center gap-2"):
            self._pick = ui.select(desk.choices(), value=str(desk.first), label="mission", with_input=True)
            self._pick.on_value_change(self._picked).props("dense").classes("w-64")
            ui.button("check", on_click=self._check).props("dense")
            self._fly = ui.button("dry run", on_click=self._dry_run).props("dense")
            self._watch = ui.link("watch it", "/dry", new_tab=True).props(named("watch"))
            ui.space()
            ui.button("save as YAML", on_click=self._save).props("dense")
            self._replace = ui.checkbox("replace what is there").props("dense")
        self._watch.set_visibility(False)
        self._said = ui.label().classes("text-sm font-bold whitespace-pre-line").props(named("said") + " role=status")
        self._bar = ui.linear_progress(show_value=False).props("indeterminate")
        self._bar.set_visibility(False)
        self._told = ui.log(max_lines=_LINES_SHOWN).classes("w-full h-24 text-xs").props(named("dry-run"))
        self._told.set_visibility(False)
        self._place = ui.row().classes("w-full no-wrap max-md:flex-wrap items-start")
        self._open(str(desk.first))
        theme.ask()

    def closed(self) -> None:
        """The browser has gone: a dry run that it began ends."""
        if self._flight is not None and self._flight.returncode is None:
            self._flight.kill()

    def _themed(self, dark: bool | None) -> None:
        self._dark = dark
        if self._editor is not None and dark is not None:
            self._editor.themed(dark=dark)

    def _picked(self, event: ValueChangeEventArguments[str | None]) -> None:
        if event.value:
            self._open(event.value)

    def _open(self, name: str) -> None:
        try:
            draft = Draft(find_config(Path(name), "missions"))
        except UserError as error:
            self._said.set_text(str(error))
            return
        self._said.set_text("")
        self._build(draft)

    def _build(self, draft: Draft) -> None:
        self._draft, self._editor = draft, None
        self._place.clear()
        with self._place:
            if draft.points:
                with ui.column().classes("w-2/5 max-md:w-full"):
                    self._editor = FormationEditor(draft, self._changed, solid=self._solid)
            with ui.column().classes("w-3/5 max-md:w-full" if draft.points else "w-full"):
                self._form = MissionForm(draft, self._changed)
                with ui.expansion("the whole file as YAML").classes("w-full") as opened:
                    whole = ui.textarea().props("outlined autogrow").classes("w-full font-mono text-xs")
                    ui.button("take it", on_click=lambda: self._take(str(whole.value))).props("dense")
                opened.on_value_change(lambda: whole.set_value(dumped(draft.values).decode()))
        self._themed(self._dark)

    def _changed(self) -> None:
        self._watch.set_visibility(False)

    def _take(self, text: str) -> None:
        """The file as it was written by hand: steps and vehicles come and go here."""
        draft = self._draft
        if draft is None:
            return
        try:
            draft.take_yaml(parse_yaml(text, "the file"))
        except UserError as error:
            self._said.set_text(str(error))
            return
        self._said.set_text("taken")
        self._build(draft)

    async def _judged(self) -> bool:
        """Whether the mission holds together; says why not, where it can at the field."""
        draft, form = self._draft, self._form
        if draft is None or form is None:
            return False
        if form.show_faults():
            self._said.set_text("not yet: see the fields that are marked")
            return False
        self._said.set_text("judging it; gains are designed where there are none")
        wrong = await run.io_bound(draft.judged)
        if wrong is None:
            return False
        words = wrong.removeprefix(f"{draft.name}.yaml: ")
        form.show_faults({words.partition(": ")[0]: words} if wrong else None)
        self._said.set_text(words or "the mission holds together")
        return not wrong

    async def _check(self) -> None:
        await self._judged()

    async def _dry_run(self) -> None:
        """Flies the draft against the emulator, in a process of its own."""
        if self._draft is None or not await self._judged():
            return
        self._fly.set_enabled(False)
        self._bar.set_visibility(True)
        self._told.set_visibility(True)
        self._told.clear()
        with tempfile.TemporaryDirectory() as folder:
            try:
                mission, log = self._draft.write(Path(folder)), Path(folder) / "dry.tlog"
                values = await self._flown(["--mission", str(mission), "--log", str(log), "--seed", "1"])
                if values is not None:
                    shown = (f"{words} {number(_float(values, name), unit, 3)}" for words, name, unit in _FIGURES)
                    reason = f": {values['reason']}" if values.get("reason") else ""
                    self._said.set_text(f"dry run {values.get('outcome')}{reason}; {', '.join(shown)}")
                    self._desk.flown = await run.io_bound(lambda: Recorded(load_flight(log)))
                    self._watch.set_visibility(self._desk.flown is not None)
            except UserError as error:
                self._said.set_text(str(error))
            finally:
                self._fly.set_enabled(True)
                self._bar.set_visibility(False)

    async def _flown(self, arguments: Sequence[str]) -> dict[str, object] | None:
        """The answer of ``gs fly --dry-run``; None, and its words said, where there is none."""
        command = [sys.executable, "-m", "groundstation", "fly", "--dry-run", "--json", *arguments]
        pipe = asyncio.subprocess.PIPE
        flight = self._flight = await asyncio.create_subprocess_exec(*command, stdout=pipe, stderr=pipe)
        answer = asyncio.create_task(flight.stdout.read()) if flight.stdout is not None else None
        last = ""
        while flight.stderr is not None and (line := await flight.stderr.readline()):
            last = line.decode(errors="replace").rstrip() or last
            self._told.push(last)
        await flight.wait()
        try:
            values = json.loads(await answer) if answer is not None else None
        except ValueError:
            values = None
        if not isinstance(values, dict):
            self._said.set_text(last or "the dry run gave no answer")
            return None
        return values

    async def _save(self) -> None:
        if self._draft is None or not await self._judged():
            return
        try:
            path = self._draft.save(self._desk.folder, replace=bool(self._replace.value))
        except UserError as error:
            self._said.set_text(str(error))
            return
        self._said.set_text(f"saved: {path}; fly it: gs fly --mission {path.stem} --console --wait")


def _float(values: dict[str, object], name: str) -> float:
    value = values.get(name)
    return float(value) if isinstance(value, int | float) else float("nan")
