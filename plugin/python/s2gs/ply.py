"""PLY files: elements of numbers and of lists that are all of one length, as programs write them for meshes and splats."""

from pathlib import Path

import numpy as np

TYPES = {"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
         "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
         "double": "f8", "float64": "f8"}


def read_ply(path):
    """{element: {property: array}} of a little-endian binary file; lists of k numbers are arrays (n, k). ValueError where the
    file is another, damaged, or its lists differ in length."""
    data = Path(path).read_bytes()
    end = data.find(b"end_header\n")
    if not data.startswith(b"ply") or end < 0:
        raise ValueError(f"{path}: is no PLY file")
    at = end + len(b"end_header\n")
    elements = []
    for line in data[:end].decode("ascii", "replace").splitlines()[1:]:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format":
            if words[1] != "binary_little_endian":
                raise ValueError(f"{path}: is {words[1]}, not binary_little_endian")
        elif words[0] == "element":
            elements.append((words[1], int(words[2]), []))
        elif words[0] == "property" and elements:
            elements[-1][2].append(words[1:])
    result = {}
    for name, count, properties in elements:
        dtype = []
        offset = 0
        for words in properties:
            if words[0] != "list":
                dtype.append((words[-1], "<" + TYPES[words[0]]))
                offset += np.dtype(TYPES[words[0]]).itemsize
                continue
            size = np.dtype("<" + TYPES[words[1]])
            if at + offset + size.itemsize > len(data):
                raise ValueError(f"{path}: ends inside its header's promises")
            length = int(np.frombuffer(data, size, 1, at + offset)[0]) if count else 0
            item = np.dtype("<" + TYPES[words[2]])
            dtype += [("length of " + words[-1], size), (words[-1], item, (length,))]
            offset += size.itemsize + length * item.itemsize
        dtype = np.dtype(dtype)
        if at + dtype.itemsize * count > len(data):
            raise ValueError(f"{path}: ends before its {count} elements of {name}")
        rows = np.frombuffer(data, dtype, count, at)
        at += dtype.itemsize * count
        columns = {}
        for column in dtype.names or ():
            if column.startswith("length of "):
                if count and np.any(rows[column] != rows[column][0]):
                    raise ValueError(f"{path}: has lists of several lengths")
            else:
                columns[column] = rows[column]
        result[name] = columns
    return result
