"""MAVLink without sockets: bytes to columns of values, columns to bytes, and what the vehicles make of them."""
