"""Keys of a mission file about its vehicles: one by one, or many alike in the short form."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from groundstation.core.findings import no_boolean
from groundstation.mission.plan.fields import Point, Positive

SYSTEM_IDS = range(1, 251)
"""MAVLink system ids that a vehicle may have: 0 means everybody, those above are other programs'."""
VEHICLE_IDS = range(1, 10_000)
"""Ids by which a mission may name its vehicles."""
_COUNT_MAX = 2_000  # as many as a formation may have points


class _Forbidding(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class VehicleSpec(_Forbidding):
    """One vehicle, its pad, and where its position counts from."""

    id: Annotated[int, BeforeValidator(no_boolean), Field(ge=VEHICLE_IDS[0], le=VEHICLE_IDS[-1])]
    sysid: Annotated[int, BeforeValidator(no_boolean), Field(ge=SYSTEM_IDS[0], le=SYSTEM_IDS[-1])] | None = None
    link: str
    autopilot: str = "px4"
    profile: str = "crazyflie"
    pad_m: Point
    origin: Literal["pad", "team", "gps", "declared"] = "pad"
    origin_m: Point | None = None
    position: Literal["local", "global"] = "local"
    endurance_s: Positive | None = None
    body: Annotated[str, Field(min_length=1, max_length=80)] | None = None

    @property
    def body_name(self) -> str:
        """Name of its body in the motion capture system."""
        return self.body or f"cf{self.id}"

    @property
    def uses_gps(self) -> bool:
        """Whether its place in the team frame comes from its place on earth."""
        return self.position == "global" or self.origin == "gps"

    @model_validator(mode="after")
    def _declared(self) -> VehicleSpec:
        if (self.origin == "declared") != (self.origin_m is not None):
            raise ValueError("origin: declared and origin_m, the place of the local frame's origin, go together")
        return self


class PadGridSpec(_Forbidding):
    """Pads in rows from west to east, the rows from south to north."""

    columns: Annotated[int, BeforeValidator(no_boolean), Field(ge=1, le=_COUNT_MAX)]
    spacing_m: Positive
    middle_m: Point = (0.0, 0.0, 0.0)

    def places_m(self, count: int) -> list[Point]:
        """Pads of so many vehicles, the first one in the south-west; a last row may be short."""
        east, north, up = self.middle_m
        rows = -(-count // self.columns)
        columns = min(self.columns, count)
        west, south = east - 0.5 * (columns - 1) * self.spacing_m, north - 0.5 * (rows - 1) * self.spacing_m
        return [
            (
                round(west + self.spacing_m * (k % self.columns), 6),
                round(south + self.spacing_m * (k // self.columns), 6),
                up,
            )
            for k in range(count)
        ]


class TeamSpec(_Forbidding):
    """Vehicles that are alike: how many, on which pads, behind which links."""

    count: Annotated[int, BeforeValidator(no_boolean), Field(ge=1, le=_COUNT_MAX)]
    pads: PadGridSpec
    links: Annotated[tuple[str, ...], Field(min_length=1)]
    per_link: Annotated[int, BeforeValidator(no_boolean), Field(ge=1, le=SYSTEM_IDS[-1])] | None = None
    autopilot: str = "px4"
    profile: str = "crazyflie"
    origin: Literal["pad", "team", "gps"] = "pad"
    position: Literal["local", "global"] = "local"
    endurance_s: Positive | None = None

    @model_validator(mode="after")
    def _room_on_the_links(self) -> TeamSpec:
        most = self.per_link or SYSTEM_IDS[-1]
        if self.count > most * len(self.links):
            raise ValueError(
                f"count is {self.count}, {len(self.links)} links of {most} vehicles take {most * len(self.links)}; give"
                " more links (a link has room for 250 system ids)"
            )
        return self

    def vehicles(self) -> tuple[VehicleSpec, ...]:
        """One by one: ids from 1 on, in the order of pads and links; as system ids where all fit, else their places."""
        each = self.per_link or -(-self.count // len(self.links))
        fits = self.count <= SYSTEM_IDS[-1]
        return tuple(
            VehicleSpec(
                id=k + 1,
                sysid=None if fits else k % each + 1,
                link=self.links[k // each],
                autopilot=self.autopilot,
                profile=self.profile,
                pad_m=pad,
                origin=self.origin,
                position=self.position,
                endurance_s=self.endurance_s,
            )
            for k, pad in enumerate(self.pads.places_m(self.count))
        )


def system_ids(vehicles: Sequence[VehicleSpec]) -> tuple[int, ...]:
    """MAVLink system id of each: the one given, the id, or where that is no system id its place on the link, from 1."""
    seen: dict[str, int] = {}
    found = []
    for vehicle in vehicles:
        place = seen[vehicle.link] = seen.get(vehicle.link, 0) + 1
        found.append(vehicle.sysid or (vehicle.id if vehicle.id in SYSTEM_IDS else place))
    return tuple(found)
