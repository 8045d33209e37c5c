"""ArduCopter 4.7 in ArduPilot's simulator (SITL), as it was seen to be started."""

from __future__ import annotations

from sitl.simulator import Place, Simulator

_PORT, _STEP = 5760, 10
_DEFAULTS = "Tools/autotest/default_params/copter.parm"


class ArduPilotSimulator(Simulator):
    """Instance i waits on tcp 5760 + 10 i; it takes any system id."""

    def instance(self, sysid: int, vehicle: int, kind: str, port: int) -> int:
        """Its number follows from the port."""
        instance, odd = divmod(port - _PORT, _STEP)
        if kind != "tcpout" or odd or instance < 0:
            raise ValueError(
                "ArduPilot's simulator waits on tcp 5760, 5770 and so on; set it to"
                f" tcpout://127.0.0.1:{_PORT + _STEP * vehicle}"
            )
        return instance

    def command(self, instance: int, sysid: int, place: Place, *, stock: bool) -> str:
        """Without the default parameters it says "Check frame class and type" for ever."""
        lat, lon, alt = place
        return (
            f'exec "$ARDUPILOT/build/sitl/bin/arducopter" -I {instance} --sysid {sysid} --model quad'
            f' --home {lat:.7f},{lon:.7f},{alt:.2f},0 --defaults "$ARDUPILOT/{_DEFAULTS}"'
        )

    def kept(self, place: Place) -> Place:
        """It stands where it was told to."""
        return place

    def remarks(self, off_m: float, *, stock: bool) -> list[str]:
        """The folder that it was built in."""
        return [
            "# ArduCopter: the folder in which `./waf copter` was run",
            ': "${ARDUPILOT:=$HOME/ardupilot}"',
            '[ -x "$ARDUPILOT/build/sitl/bin/arducopter" ] ||'
            ' { echo "ARDUPILOT=$ARDUPILOT: there is no build/sitl/bin/arducopter in it" >&2; exit 1; }',
            '# without the default parameters it says "Check frame class and type" for ever',
        ]
