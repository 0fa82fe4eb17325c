"""COLMAP's files, as far as a workspace has them: sparse models in binary form, depth and normal maps."""

import struct
from pathlib import Path

import numpy as np

# Number of parameters by COLMAP's number of a camera model, and its name.
CAMERA_MODELS = {0: ("SIMPLE_PINHOLE", 3), 1: ("PINHOLE", 4), 2: ("SIMPLE_RADIAL", 4), 3: ("RADIAL", 5), 4: ("OPENCV", 8),
                 5: ("OPENCV_FISHEYE", 8), 6: ("FULL_OPENCV", 12), 7: ("FOV", 5), 8: ("SIMPLE_RADIAL_FISHEYE", 4),
                 9: ("RADIAL_FISHEYE", 5), 10: ("THIN_PRISM_FISHEYE", 12), 11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16)}


class Reader:
    """Numbers in a row, little-endian; ValueError with the path where the file ends before them."""

    def __init__(self, path):
        self.path = Path(path)
        self.data = self.path.read_bytes()
        self.at = 0

    def take(self, form):
        size = struct.calcsize("<" + form)
        self._need(size)
        values = struct.unpack_from("<" + form, self.data, self.at)
        self.at += size
        return values

    def array(self, dtype, count):
        dtype = np.dtype(dtype)
        self._need(dtype.itemsize * count)
        values = np.frombuffer(self.data, dtype, count, self.at)
        self.at += dtype.itemsize * count
        return values

    def text(self):
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise ValueError(f"{self.path}: ends inside a name")
        text = self.data[self.at:end].decode("utf-8", "surrogateescape")
        self.at = end + 1
        return text

    def _need(self, size):
        if size < 0 or self.at + size > len(self.data):
            raise ValueError(f"{self.path}: ends at byte {len(self.data)}, before what it promises")


def transform(quaternion, translation):
    """4 x 4 from a quaternion (w, x, y, z), which need not be of unit length, and a translation."""
    w, x, y, z = np.asarray(quaternion, float) / np.linalg.norm(quaternion)
    matrix = np.eye(4)
    matrix[:3, :3] = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                      [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                      [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]
    matrix[:3, 3] = translation
    return matrix


def read_cameras(path):
    """{camera_id: (model, width, height, params)}"""
    reader = Reader(path)
    cameras = {}
    for _ in range(reader.take("Q")[0]):
        camera_id, model, width, height = reader.take("IiQQ")
        if model not in CAMERA_MODELS:
            raise ValueError(f"{path}: camera model {model} is not known")
        name, count = CAMERA_MODELS[model]
        cameras[camera_id] = (name, width, height, reader.array("<f8", count).copy())
    return cameras


def read_images(path):
    """{name: (image_id, camera_id, cam_from_world, xy (n, 2), point3D_ids (n,))}; ids of -1 are keypoints without a point."""
    reader = Reader(path)
    observation = np.dtype([("xy", "<f8", 2), ("point", "<i8")])
    images = {}
    for _ in range(reader.take("Q")[0]):
        values = reader.take("I7dI")
        name = reader.text()
        points = reader.array(observation, reader.take("Q")[0])
        images[name] = (values[0], values[8], transform(values[1:5], values[5:8]), points["xy"].copy(), points["point"].copy())
    return images


def read_points(path):
    """ids (n,), xyz (n, 3), rgb (n, 3) uint8, mean reprojection errors (n,) [px], track lengths (n,)"""
    reader = Reader(path)
    count = reader.take("Q")[0]
    rows = []
    for _ in range(count):
        values = reader.take("Q3d3BdQ")
        reader.array("<u4", 2 * values[8])
        rows.append(values)
    if not rows:
        return np.zeros(0, int), np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros(0), np.zeros(0, int)
    table = np.array(rows, float)
    return (np.array([row[0] for row in rows]), table[:, 1:4], table[:, 4:7].astype(np.uint8), table[:, 7],
            table[:, 8].astype(int))


def read_map(path):
    """A depth map (h, w) or normal map (h, w, 3), float32."""
    data = Path(path).read_bytes()
    parts = data[:64].split(b"&", 3)
    if len(parts) < 4 or not all(part.isdigit() for part in parts[:3]):
        raise ValueError(f"{path}: is no map of COLMAP")
    width, height, channels = (int(part) for part in parts[:3])
    values = np.frombuffer(data, "<f4", offset=sum(len(part) + 1 for part in parts[:3]))
    if values.size != width * height * channels:
        raise ValueError(f"{path}: has {values.size} values instead of {width} x {height} x {channels}")
    planes = values.reshape(channels, height, width)
    return planes[0].copy() if channels == 1 else np.moveaxis(planes, 0, 2).copy()
