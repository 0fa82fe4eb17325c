"""Workspaces of s2gs as numpy arrays, and its commands with progress. Transforms are 4 x 4 and named b_from_a; cameras look
along +z, x right, y down; pixels are COLMAP's: the centre of the top-left one is (0.5, 0.5)."""

from .run import Failed, Interrupted, PosesDoubtful, run
from .workspace import Camera, Mesh, Photo, Splats, Verdict, Workspace

__version__ = "0.1.0"
__all__ = ["Camera", "Failed", "Interrupted", "Mesh", "Photo", "PosesDoubtful", "Splats", "Verdict", "Workspace", "run"]
