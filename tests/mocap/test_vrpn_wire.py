"""A VRPN wire: ``gs mocap read`` against VRPN's own server (vrpn_server of github.com/vrpn/vrpn), where it is."""

from __future__ import annotations

import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from groundstation.mavlink.codec import Frame, FrameSplitter
from groundstation.mavlink.mocap_frames import room_frames
from tests.sitl.served import free_udp_port

pytest.importorskip("motioncapture", reason="motioncapture is not installed")
_SERVER = shutil.which("vrpn_server")
_MAIN = "from groundstation.app.cli import main; main()"


@pytest.mark.skipif(_SERVER is None, reason="vrpn_server is not installed")
def test_bodies_of_a_vrpn_server_come_as_frames(tmp_path: Path) -> None:
    assert _SERVER is not None
    (tmp_path / "v.cfg").write_text("vrpn_Tracker_NULL cf1 1 100.0\nvrpn_Tracker_Spin cf2 1 100.0 0.0 0.0 1.0 0.1\n")
    server = subprocess.Popen(
        [_SERVER, "-f", str(tmp_path / "v.cfg")], stdout=subprocess.DEVNULL, stderr=subprocess.STDOUT
    )
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here:
        port = free_udp_port()
        here.bind(("127.0.0.1", port))
        here.settimeout(60.0)
        words = ["mocap", "read", "--system", "vrpn", "--host", "127.0.0.1", "--link", f"udpin://127.0.0.1:{port}"]
        bodies = ["--body", "cf1=1", "--body", "cf2=2"]
        reader = subprocess.Popen([sys.executable, "-c", _MAIN, *words, *bodies], stdout=subprocess.DEVNULL)
        try:
            seen: set[int] = set()
            while seen != {0, 1}:
                pieces = FrameSplitter().feed(here.recv(4096))
                frames = [(piece, 1) for piece in pieces if isinstance(piece, Frame)]
                for frame in room_frames(frames, {1: 0, 2: 1}):
                    seen |= set(frame.row.tolist()) - {-1}
                    assert abs(frame.pos_ned_m[frame.row >= 0]).max(initial=0.0) == 0.0
        finally:
            for process in (reader, server):
                process.terminate()
                process.wait(30)
