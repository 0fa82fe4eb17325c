"""PNG files of 8 bits without interlacing, as the masks are."""

import zlib
from pathlib import Path

import numpy as np

CHANNELS = {0: 1, 2: 3, 4: 2, 6: 4}  # by colour type


def read_png(path):
    """(h, w) or (h, w, channels), uint8. ValueError for other PNG files and for damaged ones."""
    data = Path(path).read_bytes()
    if data[:8] != b"\x89PNG\r\n\x1a\n":
        raise ValueError(f"{path}: is no PNG file")
    at, packed, header, kind = 8, b"", None, b""
    while kind != b"IEND":
        size, kind = int.from_bytes(data[at:at + 4], "big"), data[at + 4:at + 8]
        body = data[at + 8:at + 8 + size]
        if zlib.crc32(kind + body).to_bytes(4, "big") != data[at + 8 + size:at + 12 + size]:
            raise ValueError(f"{path}: is damaged or cut off at byte {at}")
        if kind == b"IHDR":
            header = body
        elif kind == b"IDAT":
            packed += body
        at += 12 + size
    if header is None or len(header) != 13:
        raise ValueError(f"{path}: has no header")
    width, height = int.from_bytes(header[:4], "big"), int.from_bytes(header[4:8], "big")
    depth, color, interlaced = header[8], header[9], header[12]
    if depth != 8 or color not in CHANNELS or interlaced:
        raise ValueError(f"{path}: is a PNG file of a kind that is not read here ({depth} bits, colour type {color})")
    channels = CHANNELS[color]
    try:
        raw = np.frombuffer(zlib.decompress(packed), np.uint8)
    except zlib.error as error:
        raise ValueError(f"{path}: is damaged ({error})") from error
    if raw.size != height * (1 + width * channels):
        raise ValueError(f"{path}: has {raw.size} bytes of pixels instead of {height * (1 + width * channels)}")
    lines = raw.reshape(height, 1 + width * channels)
    image = np.zeros((height, width, channels), np.uint8)
    above = np.zeros((width, channels), np.uint8)
    for y in range(height):
        image[y] = above = _unfiltered(lines[y, 0], lines[y, 1:].reshape(width, channels), above, path)
    return image[:, :, 0] if channels == 1 else image


def _unfiltered(kind, line, above, path):
    if kind == 0:
        return line
    if kind == 1:  # the difference to the pixel at the left, modulo 256
        return np.cumsum(line, axis=0, dtype=np.uint8)
    if kind == 2:  # to the pixel above
        return line + above
    if kind not in (3, 4):
        raise ValueError(f"{path}: has a filter of unknown kind {kind}")
    result = np.empty_like(line)
    for c in range(line.shape[1]):
        left = corner = 0
        values = []
        for value, up in zip(line[:, c].tolist(), above[:, c].tolist()):
            if kind == 3:  # to the mean of both
                guess = (left + up) // 2
            else:  # to whichever of left, above and above left is nearest to left + above - above left
                p = left + up - corner
                a, b, d = abs(p - left), abs(p - up), abs(p - corner)
                guess = left if a <= b and a <= d else up if b <= d else corner
            left, corner = (value + guess) & 255, up
            values.append(left)
        result[:, c] = values
    return result
