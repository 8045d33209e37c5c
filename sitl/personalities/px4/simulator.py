"""PX4 1.16 with its built-in simulator (SIH), as it was seen to be started."""

from __future__ import annotations

import numpy as np

from sitl.simulator import Place, Simulator

_PORT, _LAST, _GCS = 14540, 14549, 14550
_PARAMS = {"EKF2_GYR_NOISE": 0.1, "EKF2_ACC_NOISE": 1.0}
_PARAMS_WHY = "PX4's estimator is told how much its simulator shakes the sensors"


class Px4Simulator(Simulator):
    """Instance i has system id i + 1 and sends to 14540 + i, all above 9 to 14549; it keeps places as floats."""

    def instance(self, sysid: int, vehicle: int, kind: str, port: int) -> int:
        """Its number follows from the system id."""
        instance = sysid - 1
        ports = (min(_PORT + instance, _LAST), _GCS)
        if kind != "udpin" or port not in ports:
            raise ValueError(
                f"PX4's simulator with system id {sysid} is instance {instance}, which sends to udp {ports[0]} (and to"
                f" {_GCS}); set it to udpin://0.0.0.0:{ports[0]}"
            )
        return instance

    def command(self, instance: int, sysid: int, place: Place, *, stock: bool) -> str:
        """Everything but its number goes by the environment."""
        lat, lon, alt = place
        settings = [
            "PX4_SIM_MODEL=sihsim_quadx", f"PX4_HOME_LAT={lat:.7f}", f"PX4_HOME_LON={lon:.7f}",
            f"PX4_HOME_ALT={alt:.2f}",
        ]  # fmt: skip
        if not stock:
            settings += [f"PX4_PARAM_{name}={value:g}" for name, value in _PARAMS.items()]
        return f'exec env {" ".join(settings)} "$PX4/bin/px4" -i {instance} -d "$PX4/etc"'

    def kept(self, place: Place) -> Place:
        """Its home is kept as floats of 32 bits."""
        lat, lon = (float(np.float32(f"{value:.7f}")) for value in place[:2])
        return lat, lon, place[2]

    def remarks(self, off_m: float, *, stock: bool) -> list[str]:
        """The folder that it was built in, how far pads are off, and its parameters."""
        found = [
            "# PX4: the folder that `make px4_sitl_default` fills",
            ': "${PX4:=$HOME/PX4-Autopilot/build/px4_sitl_default}"',
            '[ -x "$PX4/bin/px4" ] || { echo "PX4=$PX4: there is no bin/px4 in it" >&2; exit 1; }',
            f"# pads are up to {off_m:.2f} m off: it keeps its home as a float of 32 bits",
        ]
        return found if stock else [*found, f"# {' and '.join(_PARAMS)}: {_PARAMS_WHY}"]
