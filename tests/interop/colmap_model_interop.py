"""Exchanges COLMAP models with COLMAP itself.

    colmap_model_interop.py colmap   MODEL_TOOL   with the executable `colmap` (or $S2GS_COLMAP), 3.8 or newer
    colmap_model_interop.py pycolmap MODEL_TOOL   with the newest pycolmap (requirements.txt)

MODEL_TOOL is the program of model_tool.cc. Exit code 0: everything agreed.
"""

import os
import pathlib
import shutil
import subprocess
import sys
import tempfile


def run(*command):
    result = subprocess.run([str(c) for c in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if result.returncode != 0:
        sys.exit(f"{' '.join(map(str, command))}: exit code {result.returncode}\n{result.stdout}")
    return result.stdout


def check(condition, message):
    if not condition:
        sys.exit(f"FAILED: {message}")


def close(a, b, tolerance):
    return a == b or abs(a - b) <= tolerance * max(abs(a), abs(b), 1)


def items_by_id(path):
    """The words of each item of a text file by its id: old versions write the items in no particular order."""
    lines = [line.split() for line in path.read_text().split("\n")[:-1] if not line.startswith("#")]
    if path.name == "images.txt":
        lines = [lines[i] + lines[i + 1] for i in range(0, len(lines), 2)]
    return {words[0]: words for words in lines}


def check_same_text_models(a, b, tolerance):
    """Numbers equal up to a relative tolerance, everything else equal as text."""
    worst = 0.0
    for name in ("cameras.txt", "images.txt", "points3D.txt"):
        items_a, items_b = items_by_id(a / name), items_by_id(b / name)
        check(set(items_a) == set(items_b), f"{name}: ids {set(items_a)} and {set(items_b)}")
        for words_a, words_b in ((items_a[i], items_b[i]) for i in items_a):
            check(len(words_a) == len(words_b), f"{name}: {words_a} and {words_b}")
            for word_a, word_b in zip(words_a, words_b):
                if word_a == word_b:
                    continue
                try:
                    x, y = float(word_a), float(word_b)
                except ValueError:
                    check(False, f"{name}: {word_a} and {word_b}")
                worst = max(worst, abs(x - y))
                check(close(x, y, tolerance), f"{name}: {word_a} and {word_b}")
    return worst


def read_poses(tool, folder):
    poses = {}
    for line in run(tool, "poses", folder).splitlines():
        words = line.split("\t")
        poses[words[0]] = [float(w) for w in words[1:]]
    return poses


def test_colmap(tool, work):
    colmap = os.environ.get("S2GS_COLMAP", "colmap")
    check(shutil.which(colmap), f"no executable {colmap}: install the package colmap, or set S2GS_COLMAP")
    print(run(colmap, "help").splitlines()[0])

    # Ours, opened by COLMAP.
    ours = work / "ours"
    run(tool, "example", ours)
    report = run(colmap, "model_analyzer", "--path", ours)
    for line in ("Cameras: 2", "Images: 3", "Registered images: 3", "Points: 2", "Observations: 2"):
        check(line in report, f"model_analyzer does not report {line}:\n{report}")

    # Ours in binary, through COLMAP's text, back to ours: the same bytes.
    for folder in ("colmap_text", "back", "text", "colmap_binary", "colmap_text_again"):
        (work / folder).mkdir()
    run(colmap, "model_converter", "--input_path", ours, "--output_path", work / "colmap_text", "--output_type", "TXT")
    run(tool, "binary", work / "colmap_text", work / "back")
    for name in ("cameras.bin", "points3D.bin"):
        check((ours / name).read_bytes() == (work / "back" / name).read_bytes(), f"{name} came back changed")
    # COLMAP 3.8 normalises quaternions on reading, which can change the last digit.
    run(tool, "text", ours, work / "text")
    worst = check_same_text_models(work / "text", work / "colmap_text", 4e-16)
    print(f"binary -> colmap -> text: largest difference {worst:.2g}")

    # Ours in text, through COLMAP's binary. COLMAP ends names at the first space when it reads text.
    images = work / "text" / "images.txt"
    images.write_text(images.read_text().replace("sub folder/second one.png", "sub_folder/second_one.png"))
    run(colmap, "model_converter", "--input_path", work / "text", "--output_path", work / "colmap_binary",
        "--output_type", "BIN")
    run(tool, "text", work / "colmap_binary", work / "colmap_text_again")
    worst = check_same_text_models(work / "text", work / "colmap_text_again", 4e-16)
    print(f"text -> colmap -> binary: largest difference {worst:.2g}")


def test_pycolmap(tool, work):
    import numpy as np
    import pycolmap

    print("pycolmap", pycolmap.__version__)

    def read(folder):
        return pycolmap.Reconstruction(str(folder))

    def check_poses(reconstruction, folder, name):
        ours = read_poses(tool, folder)
        check(len(ours) == reconstruction.num_images(), f"{name}: {len(ours)} images")
        worst = 0.0
        for image in reconstruction.images.values():
            theirs = image.cam_from_world().matrix().ravel()
            worst = max(worst, np.abs(np.array(ours[image.name]) - theirs).max())
        check(worst <= 1e-12, f"{name}: poses differ by {worst}")
        print(f"{name}: {len(ours)} poses, largest difference {worst:.2g}")

    def check_same(a, b, name):
        check(set(a.images) == set(b.images), f"{name}: images")
        for image_id, image in a.images.items():
            other = b.images[image_id]
            check(image.name == other.name and image.camera_id == other.camera_id, f"{name}: {image.name}")
            check(image.frame_id == other.frame_id, f"{name}: frame of {image.name}")
            check(len(image.points2D) == len(other.points2D), f"{name}: keypoints of {image.name}")
            for p, q in zip(image.points2D, other.points2D):
                check((p.xy == q.xy).all() and p.point3D_id == q.point3D_id, f"{name}: keypoint of {image.name}")
            difference = np.abs(image.cam_from_world().matrix() - other.cam_from_world().matrix()).max()
            check(difference <= 1e-14, f"{name}: pose of {image.name}: {difference}")
        check(set(a.points3D) == set(b.points3D), f"{name}: points")
        for point_id, point in a.points3D.items():
            other = b.points3D[point_id]
            check((point.xyz == other.xyz).all() and (point.color == other.color).all(), f"{name}: point {point_id}")
            check(point.error == other.error, f"{name}: error of point {point_id}")
            elements = [[(e.image_id, e.point2D_idx) for e in p.track.elements] for p in (point, other)]
            check(elements[0] == elements[1], f"{name}: track of point {point_id}")
        check(set(a.rigs) == set(b.rigs) and set(a.frames) == set(b.frames), f"{name}: rigs and frames")

    # Theirs, with rigs of two cameras, read and written by us.
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs = 2
    options.num_cameras_per_rig = 2
    options.num_frames_per_rig = 4
    options.num_points3D = 50
    theirs = pycolmap.synthesize_dataset(options)
    for kind, extension in (("binary", "bin"), ("text", "txt")):
        folder = work / f"theirs_{kind}"
        folder.mkdir()
        (theirs.write_binary if kind == "binary" else theirs.write_text)(str(folder))
        check_poses(theirs, folder, f"theirs in {kind}")
        for our_kind in ("binary", "text"):
            rewritten = work / f"theirs_{kind}_to_{our_kind}"
            run(tool, our_kind, folder, rewritten)
            check_same(theirs, read(rewritten), f"theirs in {kind}, ours in {our_kind}")
        # COLMAP writes images in no particular order, everything else by id: there the bytes agree.
        rewritten = work / f"theirs_{kind}_to_binary"
        for name in ("cameras", "points3D", "rigs", "frames"):
            check((rewritten / f"{name}.bin").read_bytes() == (work / "theirs_binary" / f"{name}.bin").read_bytes(),
                  f"{name}.bin came back changed")

    # Ours, without and with rigs, read by them.
    for example, num_frames in (("example", 3), ("example_rigs", 2)):
        folder = work / example
        run(tool, example, folder)
        ours = read(folder)
        check(ours.num_frames() == num_frames, f"{example}: {ours.num_frames()} frames")
        check_poses(ours, folder, f"ours, {example}")
        again = work / f"{example}_again"
        again.mkdir()
        ours.write_text(str(again))
        check_poses(ours, again, f"ours, {example}, through their text")

    # Every camera model that they know.
    cameras = pycolmap.Reconstruction()
    models = [m for name, m in pycolmap.CameraModelId.__members__.items() if name != "INVALID"]
    for index, model in enumerate(models):
        camera = pycolmap.Camera.create_from_model_id(index + 1, model, 500.25, 640, 480)
        camera.params = [p + 0.1 * i for i, p in enumerate(camera.params)]
        cameras.add_camera(camera)
    (work / "cameras").mkdir()
    cameras.write_binary(str(work / "cameras"))
    run(tool, "text", work / "cameras", work / "cameras_text")
    back = read(work / "cameras_text")
    check(len(back.cameras) == len(models), f"{len(back.cameras)} of {len(models)} camera models")
    for camera_id, camera in cameras.cameras.items():
        other = back.cameras[camera_id]
        check(camera.model == other.model and list(camera.params) == list(other.params), f"{camera.model}")
    print(f"{len(models)} camera models")


def main():
    if len(sys.argv) != 3 or sys.argv[1] not in ("colmap", "pycolmap"):
        sys.exit(__doc__)
    tool = pathlib.Path(sys.argv[2]).resolve()
    with tempfile.TemporaryDirectory() as work:
        (test_colmap if sys.argv[1] == "colmap" else test_pycolmap)(tool, pathlib.Path(work))


if __name__ == "__main__":
    main()
