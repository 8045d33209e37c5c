"""What a wheel carries in place of pymavlink is what pymavlink says, for every message."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega

from groundstation.mavlink import layouts
from groundstation.mavlink.dialect import dialect, from_json, from_pymavlink, to_json
from groundstation.mavlink.kinds import MULTIROTORS, TYPE_GCS, type_words


def test_tables_come_back_from_json_as_they_were_and_are_all_that_pymavlink_has() -> None:
    tables = from_pymavlink()
    again = from_json(to_json(tables))
    assert again == tables
    assert to_json(again) == to_json(tables)
    assert set(again.messages) == set(ardupilotmega.mavlink_map)
    for item in again.messages.values():
        kind = ardupilotmega.mavlink_map[item.msgid]
        assert (item.name, item.crc_extra, list(item.fields)) == (kind.msgname, kind.crc_extra, kind.ordered_fieldnames)
        made, there = layouts._read_layout(item), layouts.layout(item.name)
        assert (made.dtype, made.packer.format) == (there.dtype, kind.unpacker.format)
        assert made.byte_packer.format == there.byte_packer.format


def test_numbers_and_words_of_types_are_those_of_the_dialect() -> None:
    assert (TYPE_GCS, ardupilotmega.MAV_TYPE_QUADROTOR in MULTIROTORS) == (ardupilotmega.MAV_TYPE_GCS, True)
    assert type_words(1) == "fixed wing (MAV_TYPE 1)"
    assert type_words(ardupilotmega.MAV_TYPE_ENUM_END) == f"MAV_TYPE {ardupilotmega.MAV_TYPE_ENUM_END}"
    with pytest.raises(KeyError):
        dialect().number("MAV_TYPE_ZEPPELIN")
