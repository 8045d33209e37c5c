"""A real browser for the tests of the console: Debian's chromium, driven by Playwright."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Error, Page, expect, sync_playwright

PATIENCE_MS = 180_000
"""How long a page is waited for; a machine with much else to do is slow, and nothing is judged by how long it took."""
SOFTWARE_GL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")


@contextmanager
def chromium(*arguments: str) -> Iterator[Browser]:
    """The browser, without a window; a test is left out where there is none: ``make test`` installs it where it may."""
    path = shutil.which("chromium")
    if path is None:
        pytest.skip("no chromium here, and make test could not install it: apt-get install chromium")
    expect.set_options(timeout=PATIENCE_MS)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(arguments), timeout=PATIENCE_MS)
        yield browser
        browser.close()


@dataclass
class Tab:
    """A page of its own, which shares no cookies with others.

    Attributes:
        page: Playwright's.
        wrong: what the browser's console called an error, and faults of scripts.
    """

    page: Page
    wrong: list[str] = field(default_factory=list)

    def shows(self, name: str, text: str) -> None:
        """Waits until an element of the page has exactly this text."""
        expect(self.page.get_by_test_id(name)).to_have_text(text)

    def press(self, button: str) -> None:
        """Clicks a button, by the beginning of its name."""
        self.page.get_by_role("button", name=button, exact=False).click()


def opened(
    browser: Browser, url: str, *, width: int = 800, height: int = 600, scheme: str = "light", script: str = ""
) -> Tab:
    """A new page at an address; ``script`` runs in it before its own do."""
    context = browser.new_context(
        viewport={"width": width, "height": height}, color_scheme="dark" if scheme == "dark" else "light"
    )
    context.set_default_timeout(PATIENCE_MS)
    if script:
        context.add_init_script(script)
    tab = Tab(context.new_page())

    def heard(message: ConsoleMessage) -> None:
        if message.type == "error":
            tab.wrong.append(message.text)

    def failed(error: Error) -> None:
        tab.wrong.append(str(error))

    tab.page.on("console", heard)
    tab.page.on("pageerror", failed)
    tab.page.goto(url)
    return tab
