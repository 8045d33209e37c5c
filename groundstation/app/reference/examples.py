"""An example of every command: shown by its ``--help`` and on the reference page, parsed by the tests."""

from __future__ import annotations

EXAMPLES: dict[str, tuple[str, ...]] = {
    "missions": ("gs missions",),
    "init": ("gs init mine --like cube8",),
    "new": (
        "gs new formation ring --agents 12 --spacing 1.5",
        "gs new formation points.csv --graph complete -o mine.yaml",
        "gs new formation show.skyc --at 42.5 --graph robust",
        "gs new law my_law",
    ),
    "fly": (
        "gs fly --mission cube8 --dry-run --seed 1 --set speed_limit_m_s=0.3",
        "gs fly --mission mine/mission.yaml --log flights/first",
    ),
    "command": ("gs command hold", "gs command land 3 --flight cube8", "gs command move -1 0 0.5"),
    "console": ("gs console", "gs console --flight cube8 --port 8089", "gs console --log flights/cube8.tlog"),
    "vehicles": ("gs vehicles udpin://0.0.0.0:14540 --seconds 6",),
    "check": ("gs check --mission mine/mission.yaml --fix",),
    "params": ("gs params save --mission cube8", "gs params diff --mission cube8"),
    "signing": ("gs signing new team.key", "gs signing setup --mission mine/mission.yaml"),
    "design": (
        "gs design cube8 -o cube8.npz --robustness",
        "gs design mine.yaml --suggest-graph balanced --graph-file mine-graph.yaml",
    ),
    "sitl": ("gs sitl --vehicles 8 --autopilot px4 --noise mocap",),
    "gateway": (
        "gs gateway crazyflie -v 1=udp://127.0.0.1:19850 -v 2=udp://127.0.0.1:19851",
        "gs gateway crazyflie -v 1=radio://0/80/2M/E7E7E7E701 -v 2=radio://0/80/2M/E7E7E7E702 --budget",
    ),
    "mocap": (
        "gs mocap read --mission mine/mission.yaml --system vicon --host 192.168.1.10",
        "gs mocap fake --mission lab_cube8 --fault occlude:30:33:3",
    ),
    "sitl-env": ("gs sitl-env px4_cube8",),
    "replay": ("gs replay flights/cube8-seed0 --verify",),
    "report": ("gs report flights/cube8-seed0 -o report --also svg",),
    "compare": ("gs compare flights/cube8-seed0 flights/cube8-seed0-2 -o compared",),
    "export": ("gs export flights/cube8-seed0 --to parquet -o cube8.parquet",),
    "import": ("gs import crazyswarm recorded -o imported --formation two_squares9",),
    "campaign": (
        "gs campaign --mission cube8 --runs 200 --seed 1 -o campaign",
        "gs campaign --vary wind --only 17 --log run-17",
    ),
    "identify": ("gs identify flights/cube8-seed0",),
    "schema": ("gs schema mission",),
    "completion": ("gs completion bash",),
    "bench": ("gs bench codec",),
}
"""Command: lines that can be typed as they are."""
