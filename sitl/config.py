"""What an emulated world is made of: its vehicles, their links, the air, the clock; and how a vehicle starts.

Values alone. Refuses to check them against what there is (profiles, personalities): ``world`` does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from sitl.estimator import MOCAP, Noise
from sitl.faults import Fault
from sitl.network import PERFECT, LinkConfig
from sitl.own_frame import OwnFrameConfig

SECOND = 1_000_000_000


@dataclass(frozen=True)
class Boot:
    """When, after power-up, a vehicle gets how far.

    Attributes:
        stream_ns: first message.
        heartbeat_ns: first heartbeat at the earliest.
        position_ns: position estimate.
        ready_ns: prearm checks pass (apart from the position).
        origin_ns: origin of the estimator.
        deaf_ns: mode requests are acknowledged but do nothing before this.
    """

    stream_ns: int
    heartbeat_ns: int
    position_ns: int
    ready_ns: int
    origin_ns: int
    deaf_ns: int


@dataclass(frozen=True)
class VehicleConfig:
    """One emulated vehicle.

    Attributes:
        sysid: MAVLink system id, 1 to 255, once on its link.
        autopilot: name in ``sitl.personalities.PERSONALITIES``.
        profile: name in ``sitl.personalities.PROFILES``.
        pad_enu_m: where it stands, in the world's frame.
        yaw_enu_rad: heading from east counter-clockwise.
        noise: errors of its estimate.
        streams: what it sends unasked: name in ``sitl.personalities.RATES_HZ``.
        mavlink_version: 1, 2, or 0 for 1 until a MAVLink 2 frame has come in.
        gps: whether it has a GPS receiver.
        signing_key: 32 bytes with which it signs, and without which nobody is obeyed; None for neither.
        params: names and values of parameters that differ from the firmware's defaults.
        link: number of the link that it is behind.
        name: by which faults name it; None for its system id.
    """

    sysid: int
    autopilot: str = "px4"
    profile: str = "crazyflie"
    pad_enu_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw_enu_rad: float = 0.0
    noise: Noise = MOCAP
    streams: str = "onboard"
    mavlink_version: int = 2
    gps: bool = True
    signing_key: bytes | None = field(default=None, repr=False)
    params: tuple[tuple[str, float], ...] = ()
    link: int = 0
    name: int | None = None

    @property
    def known_as(self) -> int:
        """By which number faults name it."""
        return self.sysid if self.name is None else self.name


@dataclass(frozen=True)
class WindConfig:
    """Mean wind, ENU m/s, and gusts."""

    mean_enu_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gust_sigma_m_s: float = 0.0
    gust_tau_s: float = 2.0


@dataclass(frozen=True)
class WorldConfig:
    """Everything about a world but its seed.

    Attributes:
        vehicles: in the order of their indices.
        physics_step_ns: physics step; the autopilots tick every 20 ms.
        start_ns: the clock at power-up of all vehicles.
        uplink, downlink: links to and from each vehicle.
        home_lat_deg, home_lon_deg, home_alt_m: where the world's frame has its origin.
        unix_start_us: date at power-up.
        real_boot: start-up takes as long as the real one.
        wind, downwash: options of the air.
        own_frames: how far the vehicles' ideas of north and level are off; None: they are right.
        floor_m: height of the ground beside the pads, which stand on posts then; None: it is everywhere as high as
            each vehicle's pad.
        faults: what goes wrong when; more can be injected at run time.
    """

    vehicles: Sequence[VehicleConfig]
    physics_step_ns: int = 4_000_000
    start_ns: int = 0
    uplink: LinkConfig = PERFECT
    downlink: LinkConfig = PERFECT
    home_lat_deg: float = 47.397742
    home_lon_deg: float = 8.545594
    home_alt_m: float = 488.0
    unix_start_us: int = 1_750_000_000_000_000
    real_boot: bool = False
    wind: WindConfig | None = None
    downwash: bool = False
    own_frames: OwnFrameConfig | None = None
    floor_m: float | None = None
    faults: tuple[Fault, ...] = ()
