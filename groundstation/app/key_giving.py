"""What ``gs signing setup`` does: gives a mission's key to its vehicles, and says who signs with it."""

from __future__ import annotations

from contextlib import ExitStack, closing
from ipaddress import ip_address

from rich.table import Table
from rich.text import Text

from groundstation.app.key_setup import KeySetup
from groundstation.app.loop import FlightClock, Interrupts, talk
from groundstation.app.output import Output
from groundstation.app.signing import read_keys
from groundstation.core.errors import MissionFailed, UserError
from groundstation.links.opening import open_link
from groundstation.mavlink.addresses import LinkAddress
from groundstation.mission.plan.plan import MissionPlan


def give_key(out: Output, plan: MissionPlan, seconds: float, *, in_the_clear: bool) -> None:
    """Gives the mission's key to its vehicles.

    Args:
        out: where to tell.
        plan: of the mission.
        seconds: how long to try.
        in_the_clear: over a network too, where others may hear it.

    Raises:
        UserError: the mission names no key, or it would go over a network unasked.
        MissionFailed: a vehicle did not take it.
    """
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
        table.add_row(str(vehicle.id), vehicle.state)
    out.console.print(table)
    out.result(
        {
            "mission": plan.spec.name,
            "vehicles": [{"id": item.id, "signs": item.signs, "state": item.state} for item in setup.vehicles],
        }
    )
    if not setup.done:
        late = ", ".join(str(vehicle.id) for vehicle in setup.vehicles if not vehicle.signs)
        raise MissionFailed(f"vehicles without the key after {seconds:g} s: {late}")


def _is_cable(address: LinkAddress) -> bool:
    """Whether nobody else can be expected to hear what goes over a link."""
    if address.kind == "serial":
        return True
    try:
        return ip_address(address.host).is_loopback
    except ValueError:
        return address.host == "localhost"
