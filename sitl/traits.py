"""What a personality has to say and to do: the part of an autopilot that differs from kind to kind."""

from __future__ import annotations

from abc import ABC, abstractmethod

from sitl.mission import MissionEnd


class Traits(ABC):
    """Everything that ``Autopilot`` asks its own kind for.

    Attributes:
        first_item_is_home: of a mission: it is passed over.
        vision_needs_origin: positions from outside may not be used before somebody has set an origin.
        stands_ready: it has armed itself, as its kind does from its start on, and stands with its motors off.
    """

    first_item_is_home = False
    vision_needs_origin = False
    stands_ready = False

    @abstractmethod
    def mode_name(self) -> str:
        """Name of the mode, for people."""

    @abstractmethod
    def base_mode(self) -> int:
        """MAV_MODE_FLAG bits of the heartbeat."""

    @abstractmethod
    def custom_mode(self) -> int:
        """Mode number of the heartbeat."""

    @abstractmethod
    def system_status(self) -> int:
        """MAV_STATE of the heartbeat."""

    @abstractmethod
    def sensor_bits(self) -> tuple[int, int, int]:
        """SYS_STATUS sensors: present, enabled, healthy."""

    @abstractmethod
    def acts_alone(self) -> bool:
        """Whether it is flown by a failsafe, or comes home or lands by itself."""

    @abstractmethod
    def arm_refusal(self) -> str | None:
        """Why arming is refused, None when it is not; an empty string is a refusal without words."""

    @abstractmethod
    def try_arm(self, forced: bool) -> int:
        """Arms on request. Returns the MAV_RESULT."""

    @abstractmethod
    def try_disarm(self, forced: bool) -> int:
        """Disarms on request. Returns the MAV_RESULT."""

    @abstractmethod
    def update(self, now_ns: int) -> None:
        """Lets the modes act; called every tick once the vehicle is up."""

    @abstractmethod
    def wants_up(self) -> bool:
        """Whether the present mode wants to leave the ground."""

    @abstractmethod
    def wants_down(self) -> bool:
        """Whether the present mode pushes towards the ground."""

    @abstractmethod
    def vision_enabled(self) -> bool:
        """Whether the parameters let the estimator take positions from outside."""

    @abstractmethod
    def mission_ends(self, end: MissionEnd) -> None:
        """Called when a mission asks to land here or to return, and every tick after its last item."""

    def started(self) -> None:  # noqa: B027 - silence is an answer
        """Called once, when the vehicle sends its first bytes."""

    def touched_down(self) -> None:  # noqa: B027
        """Called when the land detector has decided."""

    def datagram(self, data: bytes) -> None:  # noqa: B027
        """Takes a datagram as it came, where the kind speaks something else than MAVLink."""
