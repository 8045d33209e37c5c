"""The console in a real browser: a flight in real time is watched and steered; who may not gets nowhere.

Real time and other people's programs: pages are waited for, patiently, and nothing is judged by how long it took.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from playwright.sync_api import Browser, expect

from groundstation.mission.plan.reading import load_mission
from tests.app.browser import PATIENCE_MS, SOFTWARE_GL, Tab, chromium, opened

GS = (sys.executable, "-m", "groundstation")
FLIGHT = "fly --mission cube8 --dry-run --realtime --console --wait --seed 1 --json --set steps.1.hold.seconds=120"
_EDITOR = "getElement(+document.querySelector('canvas').parentElement.id.slice(1))"
_SOCKET = """url => new Promise(say => {
  const socket = new WebSocket(url);
  socket.onopen = () => say("open");
  socket.onerror = () => say("refused");
})"""


@contextmanager
def started(arguments: str, folder: Path) -> Iterator[subprocess.Popen[str]]:
    """A command of gs as a process of its own, killed at the end where it still runs."""
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(folder), "COLUMNS": "200"}
    with subprocess.Popen(
        [*GS, *arguments.split()],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def addresses(console: subprocess.Popen[str]) -> Mapping[str, str]:
    """What a console prints, by role: pages without the scene in 3D, which is dear without a graphics card."""
    found: dict[str, str] = {}
    assert console.stdout is not None
    for line in console.stdout:
        role, _, url = line.partition("http://")
        found[role.strip()] = "http://" + url.strip().replace("/?", "/flat?")
        if "ssh -L" in line:
            return found
    pytest.fail(f"gs console ended before it had told its addresses: {console.communicate()}")


@pytest.fixture
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short name: sockets go into it."""
    return tmp_path_factory.mktemp("c")


def test_a_flight_is_watched_and_steered_through_consoles_that_come_and_go(folder: Path) -> None:
    with chromium() as browser, started(FLIGHT, folder) as flight:
        assert flight.stderr is not None
        told = ""
        while not re.search(r"phase +connect", told):
            told = flight.stderr.readline()
            assert told, "the flight ended before it began"
        with started("console --port 0", folder) as console:
            steer = opened(browser, addresses(console)["operator"])
            steer.shows("title", "cube8")
            starts(steer)
            steer.shows("phase", "hold")
            phases = re.compile(
                ".*".join(f"phase +{name}" for name in ("connect", "arm", "takeoff", "form", "hold")), re.S
            )
            expect(steer.page.get_by_test_id("notes")).to_have_text(phases)
            expect(steer.page.get_by_test_id("shortcuts")).to_contain_text("h hold")
            steer.page.keyboard.press("m")
            expect(steer.page.get_by_role("switch", name="sound")).not_to_be_checked()
            steer.page.get_by_role("button", name="KILL: hold 1.5 s").focus()
            steer.page.keyboard.press("Space")
            steer.shows("answer", "kill: hold the button for 1.5 s")
            steer.press("hold (h)")
            steer.shows("phase", "pause")
            steer.shows("answer", "hold: taken")
            assert steer.wrong == []
            console.send_signal(signal.SIGKILL)  # in mid-flight; the next one comes into what has gone on
        with started("console --port 0", folder) as console:
            at = addresses(console)
            steer, look = (opened(browser, at[role]) for role in ("operator", "viewer"))
            look.shows("phase", "pause")
            look.page.keyboard.press("r")
            look.shows("answer", "resume: this page may only look: it was opened with the viewer's key")
            for button in ("resume (r)", "back to pads (b)", "land all (l)", "KILL: hold 1.5 s"):
                expect(look.page.get_by_role("button", name=button)).to_be_disabled()
            expect(look.page.get_by_test_id("why-not")).to_contain_text("return, land, kill: this page may only look")
            nobody_else_gets_in(browser, at["operator"], at["viewer"])
            steer.press("take the helm")
            expect(look.page.get_by_test_id("helm")).to_contain_text("steers")
            steer.page.keyboard.press("r")  # where a button was clicked before
            steer.shows("phase", "hold")
            steer.shows("answer", "resume: taken")
            steer.press("land all (l)")
            steer.shows("phase", "done")
            out, err = flight.communicate()
            ended = json.loads(out)
            for tab in (steer, look):
                tab.shows("outcome", ended["outcome"])
                tab.shows("reason", ended["reason"])
                for name in ("min_distance_m", "formation_error_m"):
                    tab.shows(name, f"{ended[name]:.3f} m")
                tab.shows("time_to_form_s", f"{ended['time_to_form_s']:.2f} s")
                for name in ("setpoints", "ticks", "deadline_misses"):
                    tab.shows(name, str(ended[name]))
                assert tab.wrong == []
    assert (ended["outcome"], ended["reason"], ended["vehicles"]) == ("aborted", "landed by the operator", 8)
    given = re.findall(r"order ([a-z ]+): given by console operator", err)
    assert given == ["start", "hold", "resume", "land all"]


def starts(steer: Tab) -> None:
    """The team waits on its pads until whoever has the helm lets it take off."""
    table, start = steer.page.get_by_test_id("preflight-table"), steer.page.get_by_role("button", name="start (s)")
    expect(table.get_by_role("cell", name="ready", exact=True)).to_have_count(8)
    expect(steer.page.get_by_test_id("notes")).to_contain_text("waits for the order `start`")
    expect(start).to_be_disabled()
    expect(steer.page.get_by_role("button", name="hold (h)")).to_be_disabled()
    steer.press("take the helm")
    expect(steer.page.get_by_role("button", name="set parameters (--fix)")).to_be_disabled()  # the mission sets them
    start.click()
    steer.shows("answer", "start: taken")
    expect(table).to_be_hidden()


def test_a_mission_is_edited_flown_as_a_dry_run_and_saved(folder: Path) -> None:
    with chromium(*SOFTWARE_GL) as browser, started("console --port 0 --edit first_flight2", folder) as console:
        at = addresses(console)["missions"]
        points_come_and_go(opened(browser, at.replace("/flat?", "/?")))
        desk = opened(browser, at)
        field = desk.page.get_by_test_id
        field("speed_limit_m_s").fill("fast")
        desk.shows("faults", "speed_limit_m_s: expected a number, got 'fast'")
        expect(desk.page.get_by_role("alert")).to_have_text("speed_limit_m_s: expected a number, got 'fast'")
        desk.press("dry run")
        desk.shows("said", "not yet: see the fields that are marked")
        field("speed_limit_m_s").fill("0.6")
        desk.shows("faults", "")
        field("name").fill("mine")
        desk.shows("gains", "gains fit this shape")
        field("point-2-z").fill("0.1")
        desk.shows("gains", "the shape has no gains yet")
        desk.press("design gains")
        expect(field("gains")).to_contain_text("gains designed")
        desk.press("dry run")
        expect(field("said")).to_contain_text("dry run completed; formed after")
        desk.press("save as YAML")
        expect(field("said")).to_contain_text("gs fly --mission mine --console --wait")
        assert desk.wrong == []
    plan = load_mission(folder / "mine.yaml")
    assert (plan.spec.speed_limit_m_s, plan.formation.size) == (0.6, 2)
    rise_m = np.diff(plan.formation.points_enu_m[:, 2])
    assert abs(float(rise_m[0])) > 0.1  # as typed, at the mission's size


def points_come_and_go(solid: Tab) -> None:
    """With the mouse, in the scene in three dimensions."""
    solid.shows("gains", "gains fit this shape")
    solid.page.locator("canvas").dblclick(position={"x": 40, "y": 250})  # the ground, in front of both
    solid.shows("size", "3 points, 2 vehicles: add 1 in the whole file as YAML")
    solid.shows("gains", "the shape has no gains yet")
    solid.press("remove point")
    solid.shows("size", "2 points, 2 vehicles")
    solid.shows("gains", "gains fit this shape")  # it is what it was
    field = solid.page.get_by_test_id
    expect(field("edges")).to_have_text("1 edges: 1-2")
    picked = solid.page.get_by_role("button", name="remove point")
    solid.page.mouse.click(*seen_at(solid, 1))
    expect(picked).to_be_enabled()
    solid.page.mouse.click(*seen_at(solid, 2))
    expect(field("edges")).to_have_text("0 edges: ")
    expect(picked).to_be_disabled()
    solid.page.mouse.click(*seen_at(solid, 2))
    expect(picked).to_be_enabled()
    solid.page.mouse.click(*seen_at(solid, 1))
    expect(field("edges")).to_have_text("1 edges: 1-2")
    solid.shows("gains", "gains fit this shape")
    x, y = seen_at(solid, 2)
    solid.page.mouse.move(x, y)
    solid.page.mouse.down()
    solid.page.mouse.move(x + 40, y - 40, steps=5)
    solid.page.mouse.up()
    solid.shows("gains", "the shape has no gains yet")
    field("points").click()
    expect(field("point-2-z")).not_to_have_value("0")
    assert solid.wrong == []
    solid.page.close()


def seen_at(solid: Tab, point: int) -> tuple[float, float]:
    """Where on the page a point of first_flight2 is, once all is there and the camera stands still.

    What the next picture would be drawn by is worked out at once: a slow renderer is a picture behind, and a click on
    what is not drawn yet hits nothing.
    """
    place = f"""(() => {{
      const scene = {_EDITOR}, box = document.querySelector("canvas").getBoundingClientRect();
      const points = [...scene.objects.values()].map(item => item.mesh).filter(mesh => mesh?.name);
      const mesh = points.find(mesh => mesh.name === "{point - 1}");
      if (points.length !== 2 || mesh?.position.x !== {point - 1}) return null;
      if (!scene.camera_tween || scene.camera_tween.isPlaying()) return null;
      scene.camera.updateMatrixWorld();
      mesh.updateWorldMatrix(true, false);
      const seen = mesh.position.clone().project(scene.camera);
      return [box.left + (1 + seen.x) / 2 * box.width, box.top + (1 - seen.y) / 2 * box.height];
    }})()"""
    x, y = solid.page.wait_for_function(place).json_value()
    return float(x), float(y)


def nobody_else_gets_in(browser: Browser, operator: str, viewer: str) -> None:
    """A page without a key, and a page of another site in a browser that has one."""
    base = operator.partition("/flat")[0]
    socket = base.replace("http", "ws") + "/_nicegui_ws/socket.io/?EIO=4&transport=websocket"
    with browser.new_context() as context:
        context.set_default_timeout(PATIENCE_MS)
        page = context.new_page()
        answer = page.goto(base)
        assert answer is not None
        assert answer.status == 403
        assert "it holds the key" in page.inner_text("body")
        assert page.evaluate(_SOCKET, socket) == "refused"
        page.goto(viewer)
        assert page.evaluate(_SOCKET, socket) == "open"  # so that it is the key that was missing
        with another_site() as elsewhere:  # on this machine: the browser sends the key along, the origin is refused
            page.goto(elsewhere)
            assert page.evaluate(_SOCKET, socket) == "refused"


@contextmanager
def another_site() -> Iterator[str]:
    """A page at another port of this machine, which to a browser is the same site."""
    with ThreadingHTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler) as server:  # its page is an error; it is one
        serving = Thread(target=server.serve_forever, daemon=True)
        serving.start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()
        serving.join()
