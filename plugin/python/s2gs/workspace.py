"""A workspace's files as numpy arrays."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List, Optional

import numpy as np

from . import colmap, png
from .ply import read_ply


@dataclass
class Camera:
    model: str  # as COLMAP names it
    width: int  # [px]
    height: int
    params: np.ndarray  # as COLMAP orders them [px]


@dataclass
class Photo:
    """A photo that has a pose."""
    name: str
    camera: Camera
    cam_from_object: np.ndarray  # (4, 4)
    station: Optional[int] = None  # from turntable.json, as all below; None where that is not there or lacks the photo
    angle_deg: Optional[float] = None  # turn of the table since the reference photo
    world_from_object: Optional[np.ndarray] = None  # (4, 4)
    cam_from_world: Optional[np.ndarray] = None  # (4, 4)


@dataclass
class Points:
    ids: np.ndarray  # (n,), COLMAP's
    xyz: np.ndarray  # (n, 3)
    rgb: np.ndarray  # (n, 3) uint8
    error_px: np.ndarray  # (n,)
    track_length: np.ndarray  # (n,)


@dataclass
class Splats:
    """2D Gaussians in the object's frame."""
    centers: np.ndarray  # (n, 3)
    scales: np.ndarray  # (n, 2), standard deviations along the first two axes of `rotations`
    rotations: np.ndarray  # (n, 4), unit quaternions w, x, y, z
    opacities: np.ndarray  # (n,), 0 to 1
    harmonics: np.ndarray  # (n, k, 3), k = 1, 4, 9 or 16: the first is .5 less than the mean colour, over .2821
    foreground: np.ndarray  # (n,), probability of turning; .8 and more counts as the rotating part


@dataclass
class Mesh:
    vertices: np.ndarray  # (n, 3), in the object's frame
    triangles: np.ndarray  # (m, 3), counter-clockwise from outside
    normals: Optional[np.ndarray] = None  # (n, 3)
    colors: Optional[np.ndarray] = None  # (n, 3) uint8
    texture_coordinates: Optional[np.ndarray] = None  # (m, 3, 2): of each triangle's corners, v upwards
    texture_pages: Optional[np.ndarray] = None  # (m,): the number of NAME_N.png


@dataclass
class Verdict:
    verdict: str  # "good", "doubtful", "failed"; "" before the poses are there
    reasons: List[str]
    advice: List[str]


class Workspace:
    """Reads when asked, and keeps nothing: what a stage writes later is seen. Missing files raise FileNotFoundError, damaged
    ones ValueError."""

    def __init__(self, path):
        self.path = Path(path)
        if not self.path.is_dir():
            raise FileNotFoundError(f"{self.path}: no such folder")

    def turntable(self) -> dict:
        """turntable.json: "axis", "stations", "scale_observable", "units", "images", and where angles
        cannot be compared between all stations "tied_stations", the sets between which they can."""
        return json.loads((self.path / "turntable.json").read_text(encoding="utf-8"))

    @property
    def units(self) -> str:
        """Of all lengths: "sfm" or "metre"."""
        return self.turntable()["units"]

    def photos(self) -> List[Photo]:
        """All photos that have a pose, by name."""
        cameras = {k: Camera(*v) for k, v in colmap.read_cameras(self.path / "sparse/0/cameras.bin").items()}
        images = colmap.read_images(self.path / "sparse/0/images.bin")
        table = {}
        if (self.path / "turntable.json").exists():
            table = {image["name"]: image for image in self.turntable()["images"]}
        photos = []
        for name, (_, camera_id, cam_from_object, _, _) in sorted(images.items()):
            photo = Photo(name, cameras[camera_id], cam_from_object)
            if name in table:
                photo.station = table[name]["station"]
                photo.angle_deg = table[name]["angle_deg"]
                photo.world_from_object = np.array(table[name]["object_to_world"], float)
                photo.cam_from_world = cam_from_object @ np.linalg.inv(photo.world_from_object)
            photos.append(photo)
        return photos

    def points(self, body="0") -> Points:
        """Sparse points of the rotating part, in the object's frame, or with body="static" of the background, in the world's."""
        return Points(*colmap.read_points(self.path / "sparse" / body / "points3D.bin"))

    def background_poses(self) -> Dict[str, np.ndarray]:
        """cam_from_world (4, 4) by name, of the photos in the background's model."""
        images = colmap.read_images(self.path / "sparse/static/images.bin")
        return {name: image[2] for name, image in sorted(images.items())}

    def mask(self, name) -> np.ndarray:
        """(h, w) bool, True on the rotating part, in the photo's own pixels."""
        return png.read_png(self.path / "masks" / (name + ".png")) > 127

    def dense_cameras(self) -> Dict[str, Camera]:
        """By photo: the pinhole cameras of dense/0/images, of the depth and the normal maps."""
        sparse = self.path / "dense/0/sparse"
        cameras = {k: Camera(*v) for k, v in colmap.read_cameras(sparse / "cameras.bin").items()}
        return {name: cameras[image[1]] for name, image in colmap.read_images(sparse / "images.bin").items()}

    def depth(self, name) -> np.ndarray:
        """(h, w) float32: depth along the camera's z, 0 where unknown. The value [y, x] belongs to the ray through the image
        position (x, y), as COLMAP's dense programs take it."""
        return colmap.read_map(self.path / "dense/0/stereo/depth_maps" / (name + ".geometric.bin"))

    def normals(self, name) -> np.ndarray:
        """(h, w, 3) float32: unit normals in the camera's frame, on the same rays."""
        return colmap.read_map(self.path / "dense/0/stereo/normal_maps" / (name + ".geometric.bin"))

    def splats(self) -> Splats:
        columns = read_ply(self.path / "s2gs/point_cloud.ply")["vertex"]

        def stacked(*names):
            return np.stack([columns[name] for name in names], axis=-1)

        rest = [f"f_rest_{i}" for i in range(45) if f"f_rest_{i}" in columns]
        # Channel by channel in the file.
        higher = stacked(*rest).reshape(-1, 3, len(rest) // 3) if rest else np.zeros((len(columns["x"]), 3, 0), np.float32)
        first = stacked("f_dc_0", "f_dc_1", "f_dc_2")[:, :, None]
        rotations = stacked("rot_0", "rot_1", "rot_2", "rot_3")
        return Splats(centers=stacked("x", "y", "z"),
                      scales=np.exp(stacked("scale_0", "scale_1")),
                      rotations=rotations / np.linalg.norm(rotations, axis=1, keepdims=True),
                      opacities=1 / (1 + np.exp(-columns["opacity"].astype(float))),
                      harmonics=np.moveaxis(np.concatenate([first, higher], axis=2), 2, 1),
                      foreground=columns["foreground"].copy())

    def mesh(self, path="dense/0/meshed-tsdf.ply") -> Mesh:
        """The mesh, or another PLY file of triangles in the workspace: "dense/0/textured-tsdf.ply" has texture."""
        elements = read_ply(self.path / path)
        vertex, face = elements["vertex"], elements["face"]

        def stacked(*names):
            return np.stack([vertex[name] for name in names], axis=-1) if all(n in vertex for n in names) else None

        mesh = Mesh(stacked("x", "y", "z").astype(float), face["vertex_indices"].astype(np.int32), stacked("nx", "ny", "nz"),
                    stacked("red", "green", "blue"))
        if "texcoord" in face:
            mesh.texture_coordinates = face["texcoord"].reshape(-1, 3, 2).copy()
            mesh.texture_pages = face["texnumber"].copy() if "texnumber" in face else np.zeros(len(face["texcoord"]), int)
        return mesh

    def report(self) -> dict:
        """report.json: stages, times, figures, and under "report" all that the page shows."""
        return json.loads((self.path / "report.json").read_text(encoding="utf-8"))

    def verdict(self) -> Verdict:
        """What the poses are worth."""
        path = self.path / "split/turntable_mapper.json"
        verdict = json.loads(path.read_text(encoding="utf-8")).get("verdict") if path.exists() else None
        verdict = verdict or {}
        return Verdict(verdict.get("verdict", ""), verdict.get("reasons", []), verdict.get("advice", []))
