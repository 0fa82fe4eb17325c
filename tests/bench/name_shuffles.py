#!/usr/bin/python3
"""Shuffles the names of a scan's photos and looks whether the poses stay the same.

usage: name_shuffles.py PROGRAM SCENE [--shuffles N] [--first K] [--work FOLDER]

SCENE has images/ and gt/scene.json. The photos are posed (`automatic_scanner --until split`) under their own names, then
under names that N random orders give them. Features do not depend on names: they are extracted once, and the database goes
along with images renamed and numbered in the order of their new names, as COLMAP would have done. A shuffle fails when a
photo that the natural order poses has no pose, or when its median rotation error is more than twice the natural order's, below
which errors of 0.02 degrees count as equal. Exit code 1 if any fails. Shuffles K to K + N - 1 are made (the seed is the
shuffle's number), so that a run can be continued.

Needs numpy of Debian.
"""
import argparse
import json
import math
import os
import pathlib
import random
import shutil
import sqlite3
import struct
import subprocess
import sys
import tempfile

import numpy as np

from exact_workspace import rotation

FLOOR_DEG = 0.02  # the shipped photos' error in the natural order: what is as good is good enough


def read_poses(folder):
    """Camera-from-object (R, t) by image name of COLMAP's images.bin."""
    path = folder / "images.bin"
    poses = {}
    if not path.exists():
        return poses
    data = path.read_bytes()
    offset = 8
    for _ in range(struct.unpack_from("<Q", data)[0]):
        values = struct.unpack_from("<I7dI", data, offset)
        offset += 64
        end = data.index(b"\0", offset)
        name = data[offset:end].decode()
        offset = end + 1
        offset += 8 + 24 * struct.unpack_from("<Q", data, offset)[0]
        poses[name] = (rotation(np.array(values[1:5])), np.array(values[5:8]))
    return poses


def rotation_errors(poses, truth):
    """Degrees, after the similarity that fits the camera centres best."""
    names = sorted(set(poses) & set(truth))
    if len(names) < 3:
        return []
    a = np.array([-poses[n][0].T @ poses[n][1] for n in names])
    b = np.array([-truth[n][0].T @ truth[n][1] for n in names])
    u, _, vt = np.linalg.svd((b - b.mean(0)).T @ (a - a.mean(0)))
    fit = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
    errors = []
    for name in names:
        error = poses[name][0] @ fit.T @ truth[name][0].T
        errors.append(np.degrees(np.arccos(np.clip((np.trace(error) - 1) / 2, -1, 1))))
    return errors


def read_truth(scene):
    truth = {}
    for image in json.loads((scene / "gt" / "scene.json").read_text())["images"]:
        pose = np.array(image["world_to_camera"]) @ np.array(image["object_to_world"])
        truth[os.path.basename(image["file"])] = (pose[:3, :3], pose[:3, 3])
    return truth


def rename_database(path, new_name):
    """Renames the images and numbers them in the order of their new names."""
    database = sqlite3.connect(path)
    images = database.execute("SELECT image_id, name FROM images").fetchall()
    shift = 1 + max(image_id for image_id, _ in images)
    order = sorted(new_name[name] for _, name in images)
    database.execute("PRAGMA foreign_keys = OFF")
    for table in ("images", "keypoints", "descriptors"):
        database.execute(f"UPDATE {table} SET image_id = image_id + {shift}")
    for image_id, name in images:
        number = 1 + order.index(new_name[name])
        for table in ("images", "keypoints", "descriptors"):
            database.execute(f"UPDATE {table} SET image_id = ? WHERE image_id = ?", (number, image_id + shift))
        database.execute("UPDATE images SET name = ? WHERE image_id = ?", (new_name[name], number))
    for table in ("matches", "two_view_geometries"):
        database.execute(f"DELETE FROM {table}")
    database.commit()
    database.close()


def scan(program, workspace, images):
    command = [program, "automatic_scanner", "--workspace_path", str(workspace), "--image_path", str(images), "--until",
               "split", "--use_gpu", "0"]
    with open(workspace / "log.txt", "w", encoding="utf-8") as log:
        return subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, check=False).returncode


def verdict_of(workspace):
    try:
        return json.loads((workspace / "split" / "turntable_mapper.json").read_text())["verdict"]["verdict"]
    except (OSError, ValueError, KeyError, TypeError):
        return "-"


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("program", type=pathlib.Path)
    parser.add_argument("scene", type=pathlib.Path)
    parser.add_argument("--shuffles", type=int, default=20)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--work", type=pathlib.Path, help="kept afterwards, natural order's poses with it")
    args = parser.parse_args()
    program = str(args.program.resolve())
    work = args.work or pathlib.Path(tempfile.mkdtemp(prefix="s2gs_shuffles_"))
    truth = read_truth(args.scene)
    photos = sorted(path for path in (args.scene / "images").iterdir() if path.is_file())
    natural = work / "natural"
    if not (natural / "sparse").exists():
        natural.mkdir(parents=True, exist_ok=True)
        scan(program, natural, args.scene / "images")
    own = read_poses(natural / "sparse" / "0")
    own_errors = rotation_errors(own, truth) or [math.inf]
    limit = max(2 * float(np.median(own_errors)), FLOOR_DEG)
    print(f"natural order: {len(own)} of {len(photos)} posed, rotation {np.median(own_errors):.4f} / "
          f"{max(own_errors):.4f} degrees, {verdict_of(natural)}", flush=True)
    num_failed = 0
    for shuffle in range(args.first, args.first + args.shuffles):
        folder = work / f"shuffle{shuffle:02d}"
        shutil.rmtree(folder, ignore_errors=True)
        (folder / "images").mkdir(parents=True)
        numbers = list(range(len(photos)))
        random.Random(shuffle).shuffle(numbers)
        new_name = {p.name: f"p{number:04d}{p.suffix}" for p, number in zip(photos, numbers)}
        for path in photos:
            shutil.copyfile(path, folder / "images" / new_name[path.name])
        shutil.copyfile(natural / "database.db", folder / "database.db")
        rename_database(folder / "database.db", new_name)
        code = scan(program, folder, folder / "images")
        old_name = {new: old for old, new in new_name.items()}
        poses = {old_name[name]: pose for name, pose in read_poses(folder / "sparse" / "0").items()}
        errors = rotation_errors(poses, truth) or [math.inf]
        has_failed = not set(own) <= set(poses) or np.median(errors) > limit
        num_failed += has_failed
        print(f"shuffle {shuffle}: {len(poses)} of {len(photos)} posed, rotation {np.median(errors):.4f} / "
              f"{max(errors):.4f} degrees, {verdict_of(folder)}, exit code {code}{', FAILS' if has_failed else ''}",
              flush=True)
        shutil.rmtree(folder / "images")
    print(f"{num_failed} of {args.shuffles} shuffles fail")
    if args.work is None:
        shutil.rmtree(work)
    return 1 if num_failed else 0


if __name__ == "__main__":
    sys.exit(main())
