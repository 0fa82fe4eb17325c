#!/usr/bin/python3
"""Writes a workspace with exact poses from a data set's ground truth, to measure the trainer by itself.

usage: exact_workspace.py SCENE WORKSPACE [--object_model DIR --static_model DIR] [--masks]

Writes sparse/0 (camera from object), sparse/static (camera from world), turntable.json, images/ (train and held-out
photos, as links), test_list.txt (the held-out ones) and truth_masks/ (to measure only). With --masks also masks/, for
the mode that needs them.

Points: none, so that training starts at random, as in the paper; or those of two COLMAP models that SfM made of the
same photos (text or binary, by `s2gs turntable_mapper` or `colmap mapper` with its own poses), moved into the exact
frame by the similarity that fits the cameras' rotations and centres. Nothing of the true surface is used.
Needs numpy (Debian: python3-numpy), and colmap where the models are binary.
"""
import argparse, json, os, subprocess, sys, tempfile
import numpy as np


def quaternion(R):
    """w, x, y, z of a rotation matrix, by the largest eigenvector (Bar-Itzhack)."""
    m = R
    k = np.array([[m[0, 0] - m[1, 1] - m[2, 2], 0, 0, 0],
                  [m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], 0, 0],
                  [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1], 0],
                  [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], m[0, 0] + m[1, 1] + m[2, 2]]]) / 3
    _, v = np.linalg.eigh(k)
    x, y, z, w = v[:, -1]
    return np.array([w, x, y, z]) * (1 if w >= 0 else -1)


def rotation(q):
    w, x, y, z = q / np.linalg.norm(q)
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


def read_model(folder):
    """Camera rotations and centres by name, and points with colour and track length, of a COLMAP model."""
    if not os.path.exists(os.path.join(folder, "points3D.txt")):
        text = tempfile.mkdtemp()
        subprocess.run(["colmap", "model_converter", "--input_path", folder, "--output_path", text,
                        "--output_type", "TXT"], check=True, stdout=subprocess.DEVNULL)
        folder = text
    with open(os.path.join(folder, "images.txt")) as f:
        lines = [line for line in f if not line.startswith("#")]
    cameras = {}
    for line in lines[::2]:
        words = line.split()
        R, t = rotation(np.array(words[1:5], float)), np.array(words[5:8], float)
        cameras[words[9]] = R, -R.T @ t
    points = []
    with open(os.path.join(folder, "points3D.txt")) as f:
        for line in f:
            if line.startswith("#"):
                continue
            words = line.split()
            points.append([float(w) for w in words[1:8]] + [(len(words) - 8) // 2])
    return cameras, np.array(points).reshape(-1, 8)


def similarity(a, b):
    """scale, R, t with x_b = scale R x_a + t, of lists of (rotation, centre) of the same cameras in both frames: R is the
    mean of what their rotations say, so that two places do; scale and t fit the centres. None where all are of one place."""
    u, _, vt = np.linalg.svd(sum(R_b.T @ R_a for (R_a, _), (R_b, _) in zip(a, b)))
    R = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    a, b = np.array([centre for _, centre in a]), np.array([centre for _, centre in b])
    ca, cb = a.mean(0), b.mean(0)
    if np.linalg.norm(b - cb, axis=1).max() < 1e-6 * max(1, np.linalg.norm(cb)):
        return None
    scale = ((b - cb) * ((a - ca) @ R.T)).sum() / ((a - ca) ** 2).sum()
    return scale, R, cb - scale * R @ ca


def write_model(folder, scene, poses, points):
    os.makedirs(folder, exist_ok=True)
    with open(os.path.join(folder, "cameras.txt"), "w") as f:
        f.write("1 PINHOLE %d %d %r %r %r %r\n" % (scene["width"], scene["height"], scene["fx"], scene["fy"],
                                                   scene["cx"], scene["cy"]))
    with open(os.path.join(folder, "images.txt"), "w") as f:
        for i, (name, pose) in enumerate(poses):
            numbers = list(quaternion(pose[:3, :3])) + list(pose[:3, 3])
            f.write("%d %s 1 %s\n\n" % (i + 1, " ".join(repr(float(n)) for n in numbers), name))
    with open(os.path.join(folder, "points3D.txt"), "w") as f:
        for i, p in enumerate(points):
            f.write("%d %r %r %r %d %d %d -1\n" % (i + 1, *(float(c) for c in p[:3]), p[3], p[4], p[5]))


def moved_points(model, poses):
    """The model's points of three photos and more, in the frame of `poses`."""
    if not model:
        return np.zeros((0, 6))
    cameras, points = read_model(model)
    exact = {name: (pose[:3, :3], -pose[:3, :3].T @ pose[:3, 3]) for name, pose in poses}
    common = sorted(set(cameras) & set(exact))
    found = similarity([cameras[n] for n in common], [exact[n] for n in common]) if common else None
    if found is None:
        sys.exit("%s: its photos are of one place, or not the scene's: it has no scale" % model)
    scale, R, t = found
    residual = [np.linalg.norm(scale * R @ cameras[n][1] + t - exact[n][1]) for n in common]
    kept = points[points[:, 7] >= 3]
    print("%s: %d points, %d images in common, centres off by %.2g (median)" %
          (model, len(kept), len(common), np.median(residual)))
    return np.hstack([scale * kept[:, :3] @ R.T + t, kept[:, 3:6]])


def link(source, target):
    if os.path.lexists(target):
        os.remove(target)
    os.symlink(os.path.abspath(source), target)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("scene")
    parser.add_argument("workspace")
    parser.add_argument("--object_model")
    parser.add_argument("--static_model")
    parser.add_argument("--masks", action="store_true")
    args = parser.parse_args()
    with open(os.path.join(args.scene, "gt", "scene.json")) as f:
        scene = json.load(f)

    for sub in ["images", "truth_masks"] + (["masks"] if args.masks else []):
        os.makedirs(os.path.join(args.workspace, sub), exist_ok=True)
    from_object, from_world, turns, held_out = [], [], [], []
    station_of = {station: i for i, station in enumerate(sorted({image["station"] for image in scene["images"]}))}
    for image in sorted(scene["images"], key=lambda i: os.path.basename(i["file"])):
        name = os.path.basename(image["file"])
        cam_from_world = np.array(image["world_to_camera"])
        world_from_object = np.array(image["object_to_world"])
        from_world.append((name, cam_from_world))
        from_object.append((name, cam_from_world @ world_from_object))
        turns.append({"name": name, "station": station_of[image["station"]], "angle_deg": image["angle_deg"],
                      "object_to_world": image["object_to_world"]})
        if image["split"] != "train":
            held_out.append(name)
        link(os.path.join(args.scene, image["file"]), os.path.join(args.workspace, "images", name))
        for sub in ["truth_masks"] + (["masks"] if args.masks else []):
            link(os.path.join(args.scene, image["mask"]), os.path.join(args.workspace, sub, name + ".png"))
    write_model(os.path.join(args.workspace, "sparse", "0"), scene, from_object,
                moved_points(args.object_model, from_object))
    write_model(os.path.join(args.workspace, "sparse", "static"), scene, from_world,
                moved_points(args.static_model, from_world))
    with open(os.path.join(args.workspace, "turntable.json"), "w") as f:
        json.dump({"version": 1, "axis": {"point": scene["axis_point"], "direction": scene["axis_direction"]},
                   "stations": len(scene["stations"]), "scale_observable": len(scene["stations"]) > 1,
                   "units": "metre", "images": turns}, f)
    with open(os.path.join(args.workspace, "test_list.txt"), "w") as f:
        f.write("".join(name + "\n" for name in held_out))
    print("%d images, %d of them held out" % (len(turns), len(held_out)))


if __name__ == "__main__":
    main()
