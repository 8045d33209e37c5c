"""A flight as Parquet: the wide table, each column with its unit; phases, events and the result beside it as JSON."""

from __future__ import annotations

import io
import json

import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]

from groundstation.records.replay import Flight
from groundstation.records.wide import Cells, unit


def write(flight: Flight, table: dict[str, Cells], made_by: str) -> tuple[bytes, dict[str, object]]:
    """The file, and what is told of it; ``table`` is ``records.wide.wide`` of the flight."""
    fields = []
    for name, column in table.items():
        of = unit(name)
        kind = pa.string() if isinstance(column, list) else pa.float64()
        fields.append(pa.field(name, kind, metadata=None if of is None else {"unit": of}))
    about = {
        "made_by": made_by,
        "name": flight.name,
        "phases": json.dumps([[item.name, *_since_s(flight, item.start_ns, item.stop_ns)] for item in flight.phases]),
        "events": json.dumps([[*_since_s(flight, item.t_ns), item.text] for item in flight.events]),
        "result": json.dumps((None if flight.manifest is None else flight.manifest.result) or {}, default=str),
    }
    sink = io.BytesIO()
    whole = pa.table(list(table.values()), schema=pa.schema(fields, metadata=about))
    pq.write_table(whole, sink, compression="zstd")
    return sink.getvalue(), {"rows": len(table["t_s"]), "columns": len(table)}


def _since_s(flight: Flight, *times_ns: int) -> list[float]:
    return [(t_ns - flight.start_ns) / 1e9 for t_ns in times_ns]
