#!/usr/bin/env python3
"""Textures one mesh by `s2gs mesh_texturer` and by COLMAP's, and compares both with photos that neither was made from.

usage: texture_against_colmap.py S2GS COLMAP WORKSPACE WORK [--test_every N] [--mesh MESH] [--masks FOLDER]

WORKSPACE is a finished scan, COLMAP an executable of 4.2 or newer (older ones have no `mesh_texturer`). Every n-th photo by name is
taken out of the scene that COLMAP gets. Both textured meshes are drawn by the same rays (Embree) with linear interpolation, and compared
with the undistorted photos over the object's masks without their outermost pixel; where there is no mesh it is black.

Prints a table: mean PSNR [dB] of the photos, of the pixels that the mesh covers, and their share; WORK/NAME/PHOTO.png has photo and mesh
side by side. Needs numpy, trimesh, embreex, pycolmap 4 and opencv-python-headless.
"""
import argparse
import pathlib
import shutil
import subprocess

import cv2
import numpy as np
import pycolmap
import trimesh
from trimesh.ray.ray_pyembree import RayMeshIntersector


def scene_without(dense, held, target):
    """The undistorted scene without the photos `held`, for COLMAP's texturer."""
    model = pycolmap.Reconstruction(str(dense / "sparse"))
    for image in list(model.images.values()):
        if image.name in held:
            model.deregister_frame(image.frame_id)
            continue
        copy = target / "images" / image.name
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(dense / "images" / image.name, copy)
    (target / "sparse").mkdir(parents=True, exist_ok=True)
    model.write(str(target / "sparse"))


class TexturedMesh:
    def __init__(self, path):
        mesh = trimesh.load(path, process=False, maintain_order=True)
        self.picture = np.asarray(mesh.visual.material.image.convert("RGB"))[:, :, ::-1].astype(np.float32)
        self.corners = mesh.vertices[mesh.faces]
        self.places = mesh.visual.uv[mesh.faces]
        self.rays = RayMeshIntersector(mesh)

    def colors(self, center, directions):
        """(n, 3) colours [0, 255] where rays hit, zero elsewhere, and (n,) whether they do."""
        faces = self.rays.intersects_first(np.repeat(center[None], len(directions), 0), directions)
        hit = faces >= 0
        a, b, c = self.corners[faces[hit]].swapaxes(0, 1)
        normal = np.cross(b - a, c - a)
        depth = ((a - center) * normal).sum(1) / (directions[hit] * normal).sum(1)
        points = center + depth[:, None] * directions[hit]
        shares = trimesh.triangles.points_to_barycentric(self.corners[faces[hit]], points)
        place = (self.places[faces[hit]] * shares[..., None]).sum(1)
        height, width = self.picture.shape[:2]
        x = (place[:, 0] * width - .5).astype(np.float32)
        y = ((1 - place[:, 1]) * height - .5).astype(np.float32)
        colors = np.zeros((len(directions), 3), np.float32)
        rows = [cv2.remap(self.picture, x[None, i:i + 30000], y[None, i:i + 30000], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0]
                for i in range(0, len(x), 30000)]
        if rows:
            colors[hit] = np.concatenate(rows)
        return colors, hit


def psnr(difference):
    return 10 * np.log10(255**2 / np.mean(difference**2))


def compare(mesh, dense, masks, model, held, pictures):
    rows = []
    for image in (i for i in model.images.values() if i.name in held):
        photo = cv2.imread(str(dense / "images" / image.name)).astype(np.float32)
        mask = cv2.imread(str(masks / (image.name + ".png")), cv2.IMREAD_GRAYSCALE) > 127
        ys, xs = np.nonzero(cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)))
        at = model.cameras[image.camera_id].cam_from_img(np.stack([xs + .5, ys + .5], 1))
        cam_from_world = image.cam_from_world().matrix()
        rotation = cam_from_world[:, :3]
        directions = np.column_stack([at, np.ones(len(at))]) @ rotation
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        colors, hit = mesh.colors(-rotation.T @ cam_from_world[:, 3], directions)
        difference = colors - photo[ys, xs]
        rows.append((psnr(difference), psnr(difference[hit]), hit.mean()))
        drawn = np.zeros_like(photo)
        drawn[ys, xs] = colors
        place = pictures / (image.name + ".png")
        place.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(place), np.hstack([photo, drawn]).astype(np.uint8))
    return np.mean(rows, axis=0)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("s2gs")
    parser.add_argument("colmap")
    parser.add_argument("workspace", type=pathlib.Path)
    parser.add_argument("work", type=pathlib.Path)
    parser.add_argument("--test_every", type=int, default=10)
    parser.add_argument("--mesh", type=pathlib.Path, help="default: the workspace's")
    parser.add_argument("--masks", type=pathlib.Path, help="compare over these, PHOTO.png; default: the object's")
    arguments = parser.parse_args()
    dense = arguments.workspace / "dense" / "0"
    mesh = arguments.mesh or dense / "meshed-tsdf.ply"
    model = pycolmap.Reconstruction(str(dense / "sparse"))
    held = set(sorted(image.name for image in model.images.values())[::arguments.test_every])
    ours, theirs = arguments.work / "s2gs", arguments.work / "colmap"
    for folder in (ours, theirs / "out"):
        folder.mkdir(parents=True, exist_ok=True)
    subprocess.run([arguments.s2gs, "mesh_texturer", "--workspace_path", arguments.workspace, "--mesh_path", mesh, "--test_every",
                    str(arguments.test_every), "--output_path", ours / "textured"], check=True)
    scene_without(dense, held, theirs / "scene")
    subprocess.run([arguments.colmap, "mesh_texturer", "--workspace_path", theirs / "scene", "--input_path", mesh, "--output_path",
                    theirs / "out"], check=True)
    print("| | object [dB] | where the mesh is [dB] | of the object [%] |\n|---|---|---|---|")
    for name, path in (("s2gs", ours / "textured.obj"), ("COLMAP", theirs / "out" / "mesh.ply")):
        all_of_it, covered, share = compare(TexturedMesh(path), dense, arguments.masks or dense / "masks", model, held,
                                             arguments.work / name / "photos")
        print(f"| {name} | {all_of_it:.2f} | {covered:.2f} | {100 * share:.1f} |")


if __name__ == "__main__":
    main()
