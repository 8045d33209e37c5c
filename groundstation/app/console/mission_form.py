"""A mission's form on the page: a field for every key, and what is wrong with it below the field."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from typing import Protocol

from nicegui import ui

from groundstation.app.console.draft import Draft
from groundstation.app.console.form import Entry, Section, form_of
from groundstation.app.console.naming import named
from groundstation.app.schema_files import schema_text
from groundstation.core.errors import UserError

_EDITED_ELSEWHERE = "formation", "gains"
_OPEN = "", "avoidance", "steps"
_NOT_GIVEN = "not given"


class _Field(Protocol):
    """What can say that something is wrong with it."""

    @property
    def error(self) -> str | None:
        """What is wrong."""

    @error.setter
    def error(self, error: str | None) -> None:
        """Says so."""


class MissionForm:
    """The form of one draft; built where it is made.

    Args:
        draft: what is edited.
        changed: told after each change.
    """

    def __init__(self, draft: Draft, changed: Callable[[], None]) -> None:
        self._draft, self._changed = draft, changed
        self._fields: dict[str, _Field] = {}
        self._unread: dict[str, str] = {}
        self._sections: dict[str, ui.label] = {}
        self._all = ui.label().classes("text-sm font-bold whitespace-pre-line").props(named("faults") + " role=status")
        form = form_of(json.loads(schema_text("mission")), draft.values, _EDITED_ELSEWHERE)
        self._parts(form)
        self.show_faults()

    def _parts(self, section: Section) -> None:
        entries = [part for part in section.parts if isinstance(part, Entry)]
        with ui.element("div").classes("w-full grid grid-cols-1 sm:grid-cols-2 lg:grid-cols-3 gap-x-4"):
            for entry in entries:
                self._entry(entry)
        for part in section.parts:
            if isinstance(part, Section):
                self._section(part)

    def _section(self, section: Section) -> None:
        """Its fields are built when it is opened: there may be two hundred vehicles."""
        key = (section.place and ".".join(map(str, section.place))) or ""
        opened = key in _OPEN or section.place[0] in _OPEN
        with ui.expansion(section.name, value=opened).classes("w-full") as item:
            if section.words:
                ui.label(section.words).classes("text-xs")
            place = ui.column().classes("w-full gap-1")
        built: list[bool] = []

        def build() -> None:
            if not built:
                built.append(True)
                with place:
                    self._parts(section)
                self.show_faults()

        if opened:
            with place:
                built.append(True)
                self._parts(section)
        else:
            item.on_value_change(build)

    def _entry(self, entry: Entry) -> None:
        label = f"{entry.name}{' *' if entry.needed else ''}"
        field: ui.input | ui.select
        if entry.choices:
            choices = {"": f"{_NOT_GIVEN}{f': {entry.default}' if entry.default else ''}"}
            choices |= {choice: choice for choice in entry.choices}
            given = entry.given if entry.given in choices else ""
            field = ui.select(choices, value=given, label=label, on_change=lambda event: self._put(entry, event.value))
        else:
            field = ui.input(
                label,
                value=entry.given,
                placeholder=entry.default,
                on_change=lambda event: self._put(entry, event.value or ""),
            )
        field.without_auto_validation().classes("w-full")
        field.props(f"dense stack-label hide-bottom-space debounce=250 {named(entry.key)}")
        if entry.words:
            with field:
                ui.tooltip(entry.words).classes("max-w-md")
        self._fields[entry.key] = field

    def _put(self, entry: Entry, text: str) -> None:
        try:
            self._draft.put(entry.place, text)
            self._unread.pop(entry.key, None)
        except UserError as error:
            self._unread[entry.key] = str(error)
        self.show_faults()
        self._changed()

    def show_faults(self, more: Mapping[str, str] | None = None) -> bool:
        """Says what is wrong, each at its field, and all of it above; returns whether anything is.

        Args:
            more: what was found besides, by key.
        """
        faults = {**self._draft.faults(), **(more or {}), **self._unread}
        at = {self._field_of(key): words for key, words in faults.items()}
        for key, field in self._fields.items():
            field.error = at.get(key)
        self._all.set_text("\n".join(faults.values()))
        return bool(faults)

    def _field_of(self, key: str) -> str:
        """The field at which a fault is told: its own, or that of what it is in."""
        while key and key not in self._fields:
            shorter = re.sub(r"(\.[^.\[\]]*|\[\d+\]|^[^.\[\]]*)$", "", key)
            key = shorter if shorter != key else ""
        return key
