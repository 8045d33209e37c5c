"""Link addresses: every form that is promised, and words for every other."""

from __future__ import annotations

import pytest

from groundstation.core.errors import UserError
from groundstation.mavlink.addresses import parse_address


@pytest.mark.parametrize(
    ("url", "kind", "where", "stream"),
    [
        ("udpin://0.0.0.0:14540", "udpin", ("0.0.0.0", 14540, "", 0), False),  # noqa: S104
        ("udpout://10.0.0.7:14550", "udpout", ("10.0.0.7", 14550, "", 0), False),
        ("tcpout://localhost:5760", "tcpout", ("localhost", 5760, "", 0), True),
        ("tcpin://[::1]:5760", "tcpin", ("::1", 5760, "", 0), True),
        ("serial:///dev/ttyUSB0:57600", "serial", ("", 0, "/dev/ttyUSB0", 57600), True),
        ("serial://COM3:115200", "serial", ("", 0, "COM3", 115200), True),
        ("mavsdk://udpin://0.0.0.0:14540", "udpin", ("0.0.0.0", 14540, "", 0), False),  # noqa: S104
        ("mavsdk://serial:///dev/ttyACM0:921600", "serial", ("", 0, "/dev/ttyACM0", 921600), False),
    ],
)
def test_every_form_is_read(url: str, kind: str, where: tuple[str, int, str, int], *, stream: bool) -> None:
    address = parse_address(url)
    assert address.kind == kind
    assert (address.host, address.port, address.device, address.baud) == where
    assert (address.is_stream, address.through_mavsdk) == (stream, url.startswith("mavsdk"))


def test_a_serial_port_carries_a_tenth_of_its_bits_as_bytes() -> None:
    assert parse_address("serial:///dev/ttyUSB0:57600").bytes_per_s == 5760
    assert parse_address("udpin://127.0.0.1:1").bytes_per_s == float("inf")


@pytest.mark.parametrize(
    "url",
    ["", "udpin://", "udpin://host", "udpin://host:x", "udpin://[", "tcp://1.2.3.4:5", "serial:///dev/ttyUSB0",
     "serial://:57600", "serial:///dev/ttyUSB0:3", "udpin://h:1/path", "mavsdk://", "mavsdk://mavsdk://udpin://h:1",
     "udpin://h:70000"],
)  # fmt: skip
def test_every_other_form_is_refused_with_those_that_there_are(url: str) -> None:
    with pytest.raises(UserError, match="expected udpin://HOST:PORT") as caught:
        parse_address(url)
    assert url in str(caught.value)
