"""Readers of point clouds that share nothing with the package's writers."""

import re

import numpy as np

TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "<i2",
    "ushort": "<u2",
    "int": "<i4",
    "uint": "<u4",
    "float": "<f4",
    "double": "<f8",
}


def read_ply(path):
    """Vertices of a binary PLY, by its header alone."""
    header, _, body = path.read_bytes().partition(b"end_header\n")
    properties = re.findall(r"property (\w+) (\S+)", header.decode())
    table = np.frombuffer(body, [(name, TYPES[kind]) for kind, name in properties])
    assert f"element vertex {table.size}\n" in header.decode()
    assert header.startswith(b"ply\nformat binary_little_endian 1.0\n")
    return table
