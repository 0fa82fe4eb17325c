#!/usr/bin/env python3
"""Compares distances between printed markers of a scan in metres with the printed ones.

usage: marker_distances.py WORKSPACE IMAGES --columns 5 --spacing_mm 40 --used 0,4,30,34 [--dictionary 7X7_250] [--least_photos 8]

WORKSPACE has been through `s2gs model_scaler`; its markers lie in rows of COLUMNS, numbered row by row. OpenCV finds them in the photos
again; the middle of each, where its diagonals meet, is the point that lies nearest to the rays of all photos that show it, in which
rays that miss it by more than three times the median are left out. Markers named by `--used`, whose size or position the scale
came from, are left out, and those that fewer than `--least_photos` show: distances between all others are compared.

Prints how many distances there are, the mean of their relative errors, what 95 % of them are below, and the same of distances longer
than 100 mm. Needs numpy, pycolmap 4 and opencv-python-headless.
"""
import argparse
import itertools
import pathlib

import cv2
import numpy as np
import pycolmap


def middle(corners):
    """Where the diagonals of a quadrilateral (4, 2) meet, [px]."""
    a, b, c, d = np.column_stack([corners, np.ones(4)])
    point = np.cross(np.cross(a, c), np.cross(b, d))
    return point[:2] / point[2]


def rays_of_markers(model, images, detector):
    """By marker: a list of (camera centre, unit direction) in the frame of the model."""
    rays = {}
    for image in model.images.values():
        photo = cv2.imread(str(images / image.name), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
        corners, ids, _ = detector.detectMarkers(photo)
        if ids is None:
            continue
        pose = image.cam_from_world()
        rotation = pose.rotation.matrix()
        for four, marker in zip(corners, ids.ravel()):
            # COLMAP's first pixel has its middle at .5, OpenCV's at 0.
            at = model.cameras[image.camera_id].cam_from_img(middle(four[0].astype(float))[None] + .5)[0]
            direction = rotation.T @ np.array([at[0], at[1], 1])
            rays.setdefault(int(marker), []).append((-rotation.T @ pose.translation, direction / np.linalg.norm(direction)))
    return rays


def nearest_point(rays):
    """The point of least squared distance from all rays but those that miss it by more than three times the median."""
    centers, directions = (np.array(part) for part in zip(*rays))
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    keep = np.ones(len(rays), bool)
    for _ in range(5):
        point = np.linalg.solve(across[keep].sum(0), np.einsum("nij,nj->i", across[keep], centers[keep]))
        miss = np.linalg.norm(np.einsum("nij,nj->ni", across, point - centers), axis=1)
        keep = miss <= 3 * np.median(miss)
    return point


def describe(errors):
    return f"mean {errors.mean():+.3f} %, 95 % below {np.percentile(np.abs(errors), 95):.3f} %, largest {np.abs(errors).max():.3f} %"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("workspace", type=pathlib.Path)
    parser.add_argument("images", type=pathlib.Path)
    parser.add_argument("--columns", type=int, required=True)
    parser.add_argument("--spacing_mm", type=float, required=True)
    parser.add_argument("--used", default="", help="numbers of markers that the scale came from")
    parser.add_argument("--dictionary", default="7X7_250")
    parser.add_argument("--least_photos", type=int, default=8)
    arguments = parser.parse_args()
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{arguments.dictionary}"))
    model = pycolmap.Reconstruction(str(arguments.workspace / "sparse" / "0"))
    rays = rays_of_markers(model, arguments.images, cv2.aruco.ArucoDetector(dictionary, parameters))
    used = {int(word) for word in arguments.used.split(",") if word}
    points = {marker: nearest_point(rays[marker]) for marker in sorted(rays)
              if marker not in used and len(rays[marker]) >= arguments.least_photos}
    printed, errors = [], []
    for a, b in itertools.combinations(points, 2):
        (row_a, column_a), (row_b, column_b) = divmod(a, arguments.columns), divmod(b, arguments.columns)
        printed.append(arguments.spacing_mm * np.hypot(row_a - row_b, column_a - column_b))
        errors.append(100 * (1000 * np.linalg.norm(points[a] - points[b]) / printed[-1] - 1))
    printed, errors = np.array(printed), np.array(errors)
    print(f"{len(points)} markers, {len(errors)} distances: {describe(errors)}")
    print(f"longer than 100 mm: {(printed > 100).sum()}, {describe(errors[printed > 100])}")


if __name__ == "__main__":
    main()
