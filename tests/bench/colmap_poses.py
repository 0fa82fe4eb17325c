#!/usr/bin/env python3
"""Poses by COLMAP alone beside those of a scan: photos placed, errors and seconds, in one table.

usage: colmap_poses.py RESULTS.jsonl SCENE=PHOTOS[=WORKSPACE] ... [--mapper incremental|global] [--threads N] [--work FOLDER]

Each SCENE folder holds gt/scene.json as render_scene.py writes it. COLMAP's way is pycolmap's: features with one simple radial
camera, all pairs, `filter_stationary_matches`, so that what stands still before a camera that does not move is left out, and a mapper;
its largest model counts. WORKSPACE is a scan's, whose sparse/0 is measured by the same rule: the cameras' places of a model are
brought to the true ones, in the frame of what turns, by the similarity of least squares; rotations are the angles between the
cameras' directions after it, centres distances in per cent of the object's size (of the disc's diameter where the scene tells no
size). A photo that has no pose counts as missing and not as wrong.

Needs numpy and pycolmap of 4.1 or newer.
"""

import argparse
import json
import pathlib
import resource
import shutil
import sys
import tempfile
import time

import numpy as np


def true_poses(scene):
    """{photo's name: 3 x 4 camera from what turns} and the length that centres are told in, in the scene's unit."""
    truth = json.loads((scene / "gt" / "scene.json").read_text())
    poses = {}
    for image in truth["images"]:
        if image["split"] == "train":
            pose = np.asarray(image["world_to_camera"]) @ np.asarray(image["object_to_world"])
            poses[pathlib.Path(image["file"]).name] = pose[:3]
    return poses, truth["options"]["size"] if "options" in truth else 2 * truth["disc"]["radius"]


def similarity(x, y):
    """Scale, rotation and translation that bring the points x to y in least squares (Umeyama 1991), n x 3 each."""
    mean_x, mean_y = x.mean(0), y.mean(0)
    u, s, vt = np.linalg.svd((y - mean_y).T @ (x - mean_x))
    sign = np.array([1, 1, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ np.diag(sign) @ vt
    scale = (s * sign).sum() / ((x - mean_x) ** 2).sum()
    return scale, rotation, mean_y - scale * rotation @ mean_x


def errors(model, truth, diameter):
    """Figures of a model ({name: 3 x 4}) against the truth."""
    names = sorted(set(model) & set(truth))
    figures = {"placed": len(names), "photos": len(truth)}
    if len(names) < 3:
        return figures
    centre = lambda pose: -pose[:, :3].T @ pose[:, 3]
    have = np.array([centre(model[n]) for n in names])
    true = np.array([centre(truth[n]) for n in names])
    scale, rotation, shift = similarity(have, true)
    off = 100 * np.linalg.norm(scale * have @ rotation.T + shift - true, axis=1) / diameter
    angles = []
    for name in names:
        between = model[name][:, :3] @ rotation.T @ truth[name][:, :3].T
        sine = np.linalg.norm([between[2, 1] - between[1, 2], between[0, 2] - between[2, 0], between[1, 0] - between[0, 1]])
        angles.append(np.degrees(np.arctan2(sine, np.trace(between) - 1)))
    figures["rotation_deg"] = [float(np.median(angles)), float(np.max(angles))]
    figures["centre_pct"] = [float(np.median(off)), float(np.max(off))]
    return figures


def poses_of(reconstruction):
    return {pathlib.Path(i.name).name: i.cam_from_world().matrix() for i in reconstruction.images.values() if i.has_pose}


def run_colmap(photos, work, mapper, threads):
    """COLMAP's largest model of the photos as {name: 3 x 4}."""
    import pycolmap

    database = work / "database.db"
    extraction = pycolmap.FeatureExtractionOptions()
    matching = pycolmap.FeatureMatchingOptions()
    extraction.num_threads = matching.num_threads = threads
    extraction.use_gpu = matching.use_gpu = False
    verification = pycolmap.TwoViewGeometryOptions()
    verification.filter_stationary_matches = True
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "SIMPLE_RADIAL"
    pycolmap.extract_features(database, photos, camera_mode=pycolmap.CameraMode.SINGLE, reader_options=reader,
                              extraction_options=extraction, device=pycolmap.Device.cpu)
    pycolmap.match_exhaustive(database, matching_options=matching, verification_options=verification, device=pycolmap.Device.cpu)
    (work / "models").mkdir()
    if mapper == "global":
        models = pycolmap.global_mapping(database, photos, work / "models")
    else:
        options = pycolmap.IncrementalPipelineOptions()
        options.num_threads = threads
        models = pycolmap.incremental_mapping(database, photos, work / "models", options)
    return poses_of(max(models.values(), key=lambda m: m.num_reg_images())) if models else {}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=pathlib.Path)
    parser.add_argument("scenes", nargs="+", metavar="SCENE=PHOTOS[=WORKSPACE]")
    parser.add_argument("--mapper", choices=["incremental", "global"], default="incremental")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--work", type=pathlib.Path)
    arguments = parser.parse_args()
    for text in arguments.scenes:
        parts = [pathlib.Path(p) for p in text.split("=")]
        truth, diameter = true_poses(parts[0])
        line = {"scene": parts[0].name}
        if len(parts) > 2:
            import pycolmap

            model = parts[2] / "sparse" / "0"
            line["s2gs"] = errors(poses_of(pycolmap.Reconstruction(model)) if model.is_dir() else {}, truth, diameter)
        work = pathlib.Path(tempfile.mkdtemp(dir=arguments.work))
        start, before = time.monotonic(), resource.getrusage(resource.RUSAGE_SELF)
        try:
            figures = errors(run_colmap(parts[1], work, arguments.mapper, arguments.threads), truth, diameter)
        except (RuntimeError, ValueError) as fault:
            figures = {"placed": 0, "photos": len(truth), "fault": str(fault)[:200]}
        after = resource.getrusage(resource.RUSAGE_SELF)
        figures["seconds"] = round(time.monotonic() - start, 1)
        figures["cpu_seconds"] = round(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, 1)
        line[f"colmap_{arguments.mapper}"] = figures
        shutil.rmtree(work)
        with arguments.results.open("a") as out:
            out.write(json.dumps(line) + "\n")
        print(json.dumps(line), flush=True)


if __name__ == "__main__":
    sys.exit(main())
