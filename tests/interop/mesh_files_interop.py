"""Another program reads our meshes as they are: PLY, OBJ and GLB.

    mesh_files_interop.py trimesh MESH_TOOL     with trimesh (requirements.txt)
    mesh_files_interop.py open3d  MESH_TOOL     with Open3D, where it is installed

MESH_TOOL is the program of mesh_tool.cc. Exit code 0: everything agreed.
"""

import os
import subprocess
import sys
import tempfile

import numpy as np


def check(condition, message):
    if not condition:
        sys.exit(f"FAILED: {message}")


def read_with_trimesh(path):
    """Vertices, triangles, normals, colours from 0 to 1; in the frame of the file's scene."""
    import trimesh

    loaded = trimesh.load(path, process=False)
    if isinstance(loaded, trimesh.Scene):
        check(len(loaded.graph.nodes_geometry) == 1, f"{path}: {len(loaded.graph.nodes_geometry)} meshes")
        transform, name = loaded.graph[loaded.graph.nodes_geometry[0]]
        mesh = loaded.geometry[name]
        # Where there is a material, the colours are kept beside it as the file has them.
        colors = np.asarray(mesh.visual.vertex_attributes["color"])
        mesh.apply_transform(transform)
    else:
        mesh = loaded
        colors = np.asarray(mesh.visual.vertex_colors)
    colors = colors[:, :3] / (np.iinfo(colors.dtype).max if colors.dtype.kind == "u" else 1)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces), np.asarray(mesh.vertex_normals), colors


def read_with_open3d(path):
    import open3d

    mesh = open3d.io.read_triangle_mesh(path)
    return (np.asarray(mesh.vertices), np.asarray(mesh.triangles), np.asarray(mesh.vertex_normals),
            np.asarray(mesh.vertex_colors))


def read_textured_with_trimesh(path):
    """Vertices, triangles, places in the picture from the bottom left, 0 to 1, and the picture."""
    import trimesh

    mesh = trimesh.load(path, process=False)
    if isinstance(mesh, trimesh.Scene):
        check(len(mesh.graph.nodes_geometry) == 1, f"{path}: {len(mesh.graph.nodes_geometry)} meshes")
        transform, name = mesh.graph[mesh.graph.nodes_geometry[0]]
        mesh = mesh.geometry[name]
        mesh.apply_transform(transform)
    material = mesh.visual.material
    picture = getattr(material, "baseColorTexture", None) or material.image
    return np.asarray(mesh.vertices), np.asarray(mesh.faces), np.asarray(mesh.visual.uv), np.asarray(picture)[..., :3]


def check_textured(folder):
    with open(os.path.join(folder, "textured.txt")) as stream:
        count = int(stream.readline())
        values = np.array([stream.readline().split() for _ in range(count)], float)
        triangles = np.array([line.split() for line in stream], int)
    points, texels, colors = values[:, :3], values[:, 3:5], values[:, 5:]
    for name in ("textured.ply", "textured.obj", "textured.glb"):
        v, t, uv, picture = read_textured_with_trimesh(os.path.join(folder, name))
        expected = points[:, [0, 2, 1]] * [1, 1, -1] if name.endswith(".glb") else points
        check(t.shape == triangles.shape, f"{name}: {t.shape} triangles, not {triangles.shape}")
        check(np.abs(v[t] - expected[triangles]).max() < 1e-6, f"{name}: other positions")
        height, width = picture.shape[:2]
        places = np.stack([uv[:, 0] * width, (1 - uv[:, 1]) * height], axis=1)
        error = np.abs(places[t] - texels[triangles]).max()
        print(f"{name}: places differ by {error:.2g} px")
        check(error < 1e-3, f"{name}: places in the picture differ by {error} px")
        found = picture[places[t][..., 1].astype(int), places[t][..., 0].astype(int)]
        check((found == colors[triangles]).all(), f"{name}: other colours in the picture")


def linear_from_srgb(color):
    return np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055)**2.4)


def main():
    reader, tool = sys.argv[1:3]
    read = {"trimesh": read_with_trimesh, "open3d": read_with_open3d}[reader]
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([tool, folder], check=True)
        with open(os.path.join(folder, "mesh.txt")) as stream:
            count = int(stream.readline())
            rows = [stream.readline().split() for _ in range(count)]
            triangles = np.array([line.split() for line in stream], int)
        values = np.array(rows, float)
        points, normals, colors = values[:, :3], values[:, 3:6], values[:, 6:] / 255
        for name in ("mesh.ply", "mesh.obj", "mesh.glb"):
            v, t, n, c = read(os.path.join(folder, name))
            check(v.shape == points.shape and t.shape == triangles.shape,
                  f"{name}: {v.shape} vertices and {t.shape} triangles, not {points.shape} and {triangles.shape}")
            expected_points, expected_normals, expected_colors = points, normals, colors
            if name == "mesh.glb":
                # glTF's y is up; its vertex colours are linear.
                expected_points = points[:, [0, 2, 1]] * [1, 1, -1]
                expected_normals = normals[:, [0, 2, 1]] * [1, 1, -1]
                expected_colors = linear_from_srgb(colors)
            # Each reader may number vertices anew, so corners of triangles are compared.
            for what, found, wanted, tolerance in (("positions", v, expected_points, 1e-6),
                                                   ("normals", n, expected_normals, 1e-5),
                                                   ("colours", c, expected_colors, 0.5 / 255 + 1e-3)):
                if what == "normals" and reader == "trimesh" and name != "mesh.glb":
                    continue  # it works them out anew
                check(found.shape == wanted.shape, f"{name}: {what} are {found.shape}, not {wanted.shape}")
                error = np.abs(found[t] - wanted[triangles]).max()
                print(f"{name}: {what} differ by {error:.2g}")
                check(error <= tolerance, f"{name}: {what} differ by {error}, more than {tolerance}")
        if reader == "trimesh":
            check_textured(folder)


main()
