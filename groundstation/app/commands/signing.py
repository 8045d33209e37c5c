"""``gs signing``: makes a signing key, and gives it to the vehicles of a mission."""

from __future__ import annotations

from contextlib import ExitStack, closing
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from groundstation.app.key_setup import KeySetup
from groundstation.app.loop import FlightClock, Interrupts, talk
from groundstation.app.output import Output
from groundstation.app.resources import find_config
from groundstation.app.signing import read_keys
from groundstation.core.errors import MissionFailed, UserError
from groundstation.links.opening import open_link
from groundstation.mavlink.addresses import LinkAddress
from groundstation.mavlink.keys import new_key
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.reading import load_mission


def signing(
    action: Annotated[str, typer.Argument(help="new: make a key. setup: give a mission's key to its vehicles.")],
    file: Annotated[Path | None, typer.Argument(help="new: key file to make.")] = None,
    *,
    mission: Annotated[Path | None, typer.Option("--mission", help="setup: mission file that names the key.")] = None,
    changes: Annotated[
        list[str] | None, typer.Option("--set", help="key.path=value: changes the mission, may be repeated.")
    ] = None,
    in_the_clear: Annotated[
        bool, typer.Option("--in-the-clear", help="setup: send the key over a network too, where others may hear it.")
    ] = False,
    seconds: Annotated[float, typer.Option(help="setup: how long to try.", min=1, max=600)] = 15.0,
    as_json: Annotated[bool, typer.Option("--json", help="Answer with one JSON object.")] = False,
) -> None:
    """Makes a key for MAVLink signing (new FILE), or gives a mission's key to its vehicles (setup --mission FILE)."""
    out = Output(as_json=as_json)
    if action == "new" and file is not None and mission is None:
        new_key(file)
        out.console.print(
            Text(f"{file}: a new key, readable by you alone. Name it in the mission: signing: {{key_file: {file}}}")
        )
        out.result({"key_file": str(file)})
    elif action == "setup" and mission is not None and file is None:
        plan = load_mission(find_config(mission, "missions"), changes or ())
        _setup(out, plan, seconds, in_the_clear=in_the_clear)
    else:
        raise UserError(
            f"signing {action}: expected gs signing new FILE, or gs signing setup --mission FILE (which names the key)"
        )


def _setup(out: Output, plan: MissionPlan, seconds: float, *, in_the_clear: bool) -> None:
    keys = read_keys(plan)
    if not any(keys):
        raise UserError(f"{plan.source}: signing: is missing; name the key: signing: {{key_file: team.key}}")
    for address, key in zip(plan.addresses, keys, strict=True):
        if key is not None and not in_the_clear and not _is_cable(address):
            raise UserError(
                f"{address.url}: the key would go over a network readable for everybody; connect the vehicles by USB"
                " (serial://), or add --in-the-clear where nobody listens"
            )
    out.console.print(
        Text("The key goes to the vehicles readable, as MAVLink has it: over a radio others can take it.")
    )
    clock, interrupts = FlightClock(), Interrupts()
    setup = KeySetup(plan, keys, clock.epoch_unix_us)
    with ExitStack() as stack:
        links = [stack.enter_context(closing(open_link(url))) for url in plan.links]
        stack.enter_context(interrupts.listening())
        talk(
            links,
            clock,
            seconds,
            receive=setup.receive,
            outgoing=setup.outgoing,
            interrupts=interrupts,
            done=lambda: setup.done,
        )
    table = Table("vehicle", "state")
    for vehicle in setup.vehicles:
        table.add_row(str(vehicle.sysid), vehicle.state)
    out.console.print(table)
    out.result(
        {
            "mission": plan.spec.name,
            "vehicles": [{"id": item.sysid, "signs": item.signs, "state": item.state} for item in setup.vehicles],
        }
    )
    if not setup.done:
        late = ", ".join(str(vehicle.sysid) for vehicle in setup.vehicles if not vehicle.signs)
        raise MissionFailed(f"vehicles without the key after {seconds:g} s: {late}")


def _is_cable(address: LinkAddress) -> bool:
    """Whether nobody else can be expected to hear what goes over a link."""
    if address.kind == "serial":
        return True
    try:
        return ip_address(address.host).is_loopback
    except ValueError:
        return address.host == "localhost"
