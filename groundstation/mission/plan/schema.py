"""The mission file as YAML says it: keys, types and ranges, which alone are judged here. Unknown keys are errors."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    GetJsonSchemaHandler,
    SerializerFunctionWrapHandler,
    Tag,
    model_serializer,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from groundstation.core.files import faults
from groundstation.core.findings import no_boolean
from groundstation.mission.plan.fields import NotNegative, Number, Point, Positive
from groundstation.mission.plan.gateway_spec import GatewaySpec
from groundstation.mission.plan.obstacle_spec import ObstacleSpec, TrafficSpec
from groundstation.mission.plan.positioning_spec import PositioningSpec
from groundstation.mission.plan.profile_spec import ProfileSpec
from groundstation.mission.plan.sensing_spec import SensingSpec
from groundstation.mission.plan.vehicle_spec import TeamSpec, VehicleSpec

_COMES_TO_REST_S = 2.0


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class ScaleSpec(_Strict):
    """f of (14): gain = 1/k of ``arctan`` or ``tanh``; ``free`` leaves the scale to the start."""

    kind: Literal["arctan", "tanh", "free"] = "arctan"
    gain: Literal["auto"] | Annotated[Number, Field(gt=0, le=100)] = "auto"


def _by_name(value: object) -> object:
    """A name alone stands for code without options."""
    return {"use": value} if isinstance(value, str) else value


class OwnCodeSpec(_Strict):
    """Code of one's own: ``module:name`` or the name of an entry point, and what its constructor is given."""

    use: Annotated[str, Field(min_length=1, max_length=200)]
    options: dict[str, object] = {}


OwnCodeName = Annotated[OwnCodeSpec, BeforeValidator(_by_name, json_schema_input_type=str | OwnCodeSpec)]


class AvoidanceSpec(_Strict):
    """Safety radius r and activation distance d of Algorithm 2, and what stands above and below where it is no ball."""

    radius_m: Positive
    activation_m: Positive
    shape: Literal["sphere", "cylinder", "ellipsoid"] = "sphere"
    half_height_m: Positive | None = None
    law: OwnCodeName | None = None
    method: Literal["rotation", "damper", "both"] = "both"
    detours: bool = True

    @model_validator(mode="after")
    def _own_law_turns(self) -> AvoidanceSpec:
        if self.law is not None and self.method == "damper":
            raise ValueError("law stands in for Algorithm 2, which method: damper leaves out; give one of them")
        return self

    @property
    def turns(self) -> bool:
        """Algorithm 2 turns what agents of a formation wish."""
        return self.method != "damper"

    @property
    def damps(self) -> bool:
        """The damper bounds how fast agents of a formation close; without it r is for points without lag."""
        return self.method != "rotation"

    @model_validator(mode="after")
    def _spheres_have_none(self) -> AvoidanceSpec:
        if self.shape == "sphere" and self.half_height_m is not None:
            raise ValueError("half_height_m belongs to shape: cylinder or ellipsoid; a sphere has radius_m only")
        return self


class TakeoffSpec(_Strict):
    """Height above the pads at which the team gathers, and how much roles that end higher start higher."""

    height_m: Annotated[Number, Field(ge=0.2, le=1_000)] = 0.5
    stagger_m: NotNegative = 0.0
    timeout_s: Positive = 20.0
    wait: bool = False


class StepSpec(_Strict):
    """One step of a mission: in the file an item with one key, which says of what kind it is."""

    kind: ClassVar[str]
    formed: ClassVar[bool] = True
    """Is of a formation, which has been formed before it or is now."""

    @model_validator(mode="before")
    @classmethod
    def _below_its_key(cls, value: object) -> object:
        if isinstance(value, dict) and set(value) == {cls.kind}:
            return {} if value[cls.kind] is None else value[cls.kind]
        return value

    @model_serializer(mode="wrap")
    def _with_its_key(self, values: SerializerFunctionWrapHandler) -> dict[str, object]:
        return {self.kind: values(self)}

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """The item with its key, for editors."""
        inner = handler(core)
        return {
            "type": "object",
            "properties": {cls.kind: inner},
            "required": [cls.kind],
            "additionalProperties": False,
        }

    def longest_s(self, move_s: float) -> float:
        """How long it takes at most, s.

        Args:
            move_s: what moving from one formation to another takes.
        """
        raise NotImplementedError

    @property
    def form(self) -> FormStep | None:
        """The formation that begins with it; None where none does."""
        return None

    @property
    def move(self) -> MoveStep | None:
        """How it moves the formation as one; None where it does not."""
        return None

    @property
    def lead(self) -> LeadStep | None:
        """What the operator may make of the formation; None where the mission alone moves it."""
        return None

    def places_m(self) -> tuple[Point, ...]:
        """Where the middle of the team goes in a step that forms nothing, one place after the other."""
        return ()


class FormStep(StepSpec):
    """Form until every distance is within tolerance; what is not given is as at the top of the mission."""

    kind: ClassVar[str] = "form"
    tolerance_m: Positive = 0.05
    timeout_s: Positive = 60.0
    formation: str | None = None
    gains: str | None = None
    formation_scale: Positive | None = None
    scale: ScaleSpec | None = None
    assignment: Literal["auto", "fixed"] | None = None

    @property
    def form(self) -> FormStep:
        """Its own."""
        return self

    @property
    def own_shape(self) -> bool:
        """Whether it names points, size or gains of its own."""
        return not (self.formation is None and self.gains is None and self.formation_scale is None)

    def longest_s(self, move_s: float) -> float:
        """A move to the formation, and no longer than it may take."""
        return min(move_s, self.timeout_s)


class HoldStep(StepSpec):
    """Keep the formation."""

    kind: ClassVar[str] = "hold"
    seconds: Positive = 5.0

    def longest_s(self, move_s: float) -> float:
        """As long as it says."""
        return self.seconds


class MoveStep(StepSpec):
    """Move, turn and scale the formation as one; without a duration as fast as half of the limits allow."""

    kind: ClassVar[str] = "move"
    by_m: Point = (0.0, 0.0, 0.0)
    turn_deg: Annotated[Number, Field(ge=-3600, le=3600)] = 0.0
    scale: Annotated[Number, Field(ge=0.1, le=10)] = 1.0
    seconds: Positive | None = None

    @property
    def move(self) -> MoveStep:
        """As it says."""
        return self

    def longest_s(self, move_s: float) -> float:
        """As long as it says, or what a move between formations takes."""
        return move_s if self.seconds is None else self.seconds


class LeadStep(StepSpec):
    """Keep the formation, and move, turn and scale it as the operator says."""

    kind: ClassVar[str] = "lead"
    seconds: Positive = 60.0
    smallest: Annotated[Number, Field(ge=0.1, le=10)] = 1.0
    largest: Annotated[Number, Field(ge=0.1, le=10)] = 2.0

    @model_validator(mode="after")
    def _smallest_first(self) -> LeadStep:
        if self.smallest > self.largest:
            raise ValueError(f"smallest is {self.smallest:g} and largest {self.largest:g}; give the smaller one first")
        return self

    @property
    def lead(self) -> LeadStep:
        """As it says."""
        return self

    def longest_s(self, move_s: float) -> float:
        """As long as it says, and what coming to rest takes."""
        return self.seconds + _COMES_TO_REST_S


class PlaceStep(StepSpec):
    """A step in which vehicles fly to places, or stay in theirs, and form nothing."""

    formed: ClassVar[bool] = False

    def longest_s(self, move_s: float) -> float:
        """What it stays; the ways are reckoned from the places."""
        return 0.0


class HoverStep(PlaceStep):
    """Stay where everybody is."""

    kind: ClassVar[str] = "hover"
    seconds: Positive = 5.0

    def longest_s(self, move_s: float) -> float:
        """As long as it says."""
        return self.seconds


class GoToStep(PlaceStep):
    """Fly to a place: the middle of the team, and everybody in step with it."""

    kind: ClassVar[str] = "go_to"
    to_m: Point
    tolerance_m: Positive | None = None
    timeout_s: Positive = 60.0

    def places_m(self) -> tuple[Point, ...]:
        """The one."""
        return (self.to_m,)


class WaypointsStep(PlaceStep):
    """Fly through places to the last of them, with so much time for each."""

    kind: ClassVar[str] = "waypoints"
    through_m: Annotated[tuple[Point, ...], Field(min_length=1, max_length=1_000)]
    tolerance_m: Positive | None = None
    timeout_s: Positive = 60.0

    def places_m(self) -> tuple[Point, ...]:
        """All of them."""
        return self.through_m


def _kind_of(value: object) -> str | None:
    """The key of an item."""
    if isinstance(value, StepSpec):
        return value.kind
    return str(next(iter(value))) if isinstance(value, dict) and len(value) == 1 else None


def _one_key(value: object) -> object:
    if _kind_of(value) is None:
        raise ValueError("a step has exactly one key, for example `- hold: {seconds: 5}`")
    return value


Step = Annotated[
    Annotated[FormStep, Tag("form")]
    | Annotated[HoldStep, Tag("hold")]
    | Annotated[MoveStep, Tag("move")]
    | Annotated[LeadStep, Tag("lead")]
    | Annotated[HoverStep, Tag("hover")]
    | Annotated[GoToStep, Tag("go_to")]
    | Annotated[WaypointsStep, Tag("waypoints")],
    Discriminator(_kind_of),
    BeforeValidator(_one_key),
]
"""A new kind of step is a class here, which answers what is asked of all of them, and one in ``flight.steps``."""


class LandSpec(_Strict):
    """Where the team lands."""

    at: Literal["pads"] = "pads"
    timeout_s: Positive = 60.0


class FenceSpec(_Strict):
    """Box that no vehicle may leave, team frame, ENU, and whether the autopilots are given it."""

    min_m: Point
    max_m: Point
    upload: bool = False
    rally: bool = False

    @model_validator(mode="after")
    def _rally_goes_with_it(self) -> FenceSpec:
        if self.rally and not self.upload:
            raise ValueError("rally goes with upload: true")
        return self


class _FlightLimits(_Strict):
    """Ages and times after which the ground station reacts; errors by the position source where not given."""

    pose_age_s: Positive = 0.5
    pose_lost_s: Positive = 1.0
    heartbeat_age_s: Positive = 4.0
    preflight_s: Positive = 120.0
    arming_s: Positive = 60.0
    pad_error_m: Positive | None = None
    frame_drift_m: Positive | None = None
    hold_s: Positive = 300.0
    pose_jump_m: Positive | None = None
    tilt_deg: Annotated[Number, Field(ge=10, le=180)] = 60.0
    fence_beyond_m: Positive = 0.3
    tracking_m_s: Positive | None = None
    velocity_error_m_s: Positive = 0.7  # twice what PX4's simulator has, which is flown
    late_s: Positive = 1.0
    lost_radius_m: NotNegative | None = None


class LimitsSpec(_FlightLimits):
    """The same, and those of the batteries."""

    battery_min: Annotated[Number, Field(ge=0, lt=1)] = 0.2
    battery_warn: Annotated[Number, Field(ge=0, lt=1)] | None = None
    battery_land: Annotated[Number, Field(ge=0, lt=1)] | None = None
    battery_min_v: Positive | None = None
    battery_land_v: Positive | None = None
    battery_age_s: Positive = 10.0


class WindSpec(_Strict):
    """Wind that a mission may be flown in, by the profiles where not given: mean, and standard deviation of gusts."""

    mean_m_s: Annotated[Number, Field(ge=0, le=30)] | None = None
    gust_m_s: Annotated[Number, Field(ge=0, le=15)] | None = None


class FailsafeSpec(_Strict):
    """What the team does when nobody steers it any more, and whether its parameters are set to that."""

    action: Literal["auto", "return", "land", "hold", "own"] = "auto"
    hold_s: Annotated[Number, Field(ge=10, le=60)] = 20.0
    ceiling_m: Positive | None = None
    set_parameters: bool = False


def _no_longitude(value: object) -> object:
    """Asks whether what is too much for a latitude was meant for the longitude."""
    if isinstance(value, float | int) and 89.0 < abs(value) <= 180.0:
        raise ValueError("expected -89 to 89 (are anchor.lat_deg and anchor.lon_deg swapped?)")
    return value


class AnchorSpec(_Strict):
    """Where on earth the team frame has its origin: degrees, and metres above sea level."""

    lat_deg: Annotated[float, BeforeValidator(_no_longitude), Field(ge=-89, le=89)]
    lon_deg: Annotated[float, Field(ge=-180, le=180)]
    alt_m: Annotated[float, Field(ge=-500, le=9000)]


class LinkSigningSpec(_Strict):
    """Signing of one link; ``key_file: null`` leaves it unsigned."""

    key_file: Annotated[str, Field(min_length=1)] | None = None
    link_id: Annotated[int, BeforeValidator(no_boolean), Field(ge=0, le=255)] | None = None


class SigningSpec(LinkSigningSpec):
    """MAVLink 2 signing: of all links, and of single ones that differ, by address."""

    links: dict[str, LinkSigningSpec] = {}


class _FormationKeys(_Strict):
    """What is formed, and by which law."""

    name: Annotated[str, Field(max_length=80, pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]
    formation: str | None = None
    formation_scale: Positive | None = None
    gains: str | None = None
    law: OwnCodeName | None = None
    rate_hz: Annotated[Number, Field(ge=10, le=200)] = 50.0
    speed_limit_m_s: Annotated[Number, Field(ge=0.05, le=20)] = 0.5
    acceleration_limit_m_s2: Annotated[Number, Field(ge=0.1, le=20)] | None = None
    gain: Literal["auto"] | Annotated[Number, Field(gt=0, le=10)] = "auto"
    lead_s: Literal["auto"] | Annotated[Number, Field(ge=0, le=10)] = "auto"
    upright_1_s: Annotated[Number, Field(ge=0, le=100)] = 1.0
    scale: ScaleSpec = ScaleSpec()
    avoidance: AvoidanceSpec
    assignment: Literal["auto", "fixed"] = "auto"
    role_swaps: Literal["auto"] | bool = "auto"


class _CourseKeys(_FormationKeys):
    """What is done one after the other, within which limits."""

    min_altitude_m: NotNegative | None = None
    takeoff: TakeoffSpec = TakeoffSpec()
    steps: Annotated[tuple[Step, ...], Field(min_length=1)]
    land: LandSpec = LandSpec()
    on_lost: Literal["return_all", "continue_open", "continue_take_over"] = "return_all"
    fence: FenceSpec
    obstacles: Annotated[tuple[ObstacleSpec, ...], Field(max_length=32)] = ()
    traffic: TrafficSpec | None = None
    sensing: SensingSpec | None = None
    limits: LimitsSpec = LimitsSpec()
    wind: WindSpec = WindSpec()
    keep_place_1_s: Literal["auto"] | Annotated[Number, Field(ge=0, le=1)] = "auto"
    failsafe: FailsafeSpec = FailsafeSpec()


def _one_by_one(value: object) -> object:
    """Vehicles in the short form, one by one."""
    if not isinstance(value, dict):
        return value
    wrong = faults(TeamSpec, value)
    if wrong:
        raise ValueError("; ".join(wrong.values()))
    return TeamSpec.model_validate(value).vehicles()


Vehicles = Annotated[
    tuple[VehicleSpec, ...],
    Field(min_length=1),
    BeforeValidator(_one_by_one, json_schema_input_type=tuple[VehicleSpec, ...] | TeamSpec),
]


class MissionSpec(_CourseKeys):
    """The whole file."""

    positioning: Literal["mocap", "rtk", "gps"] | PositioningSpec | None = None
    position_error_m: Positive | None = None
    anchor: AnchorSpec | None = None
    set_gps_origin: bool = False
    link_delay_s: NotNegative = 0.0
    link_bytes_per_s: dict[str, Positive] = {}
    signing: SigningSpec | None = None
    forward: str | None = None
    gateway: GatewaySpec | None = None
    profiles: dict[str, ProfileSpec] = {}
    compensate_s: Literal["auto", 0] | Annotated[Number, Field(ge=0.2, le=2)] = "auto"
    vehicles: Vehicles
