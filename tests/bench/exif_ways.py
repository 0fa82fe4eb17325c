#!/usr/bin/python3
"""Scans one photo set stored in all eight ways of EXIF's orientation and compares the models and the pictures.

usage: exif_ways.py PROGRAM IMAGES WORK [--ways 1,2,3,4,5,6,7,8]

IMAGES are JPEGs that stand upright, of sides that are multiples of 16, so that jpegtran turns and mirrors them without loss; they
are cut to less than their height, so that width and height cannot be mixed up. `automatic_scanner --until split` poses each way,
and per way this says: photos with a pose; distance of camera centres from those of way 1, after the similarity that fits them best,
in % of the cameras' spread, median and largest; and the largest difference of the report's thumbnails from way 1's, in grey values,
as a mean over a thumbnail. Exit code 1 where fewer photos have a pose, the median is above .1 %, or a thumbnail differs by more
than 8 grey values: pictures that are turned or mirrored differ by 20 to 60.

Needs jpegtran, exiftool, and numpy and PIL.
"""
import argparse
import base64
import io
import pathlib
import re
import subprocess
import sys

import numpy as np
from PIL import Image

from name_shuffles import read_poses

# jpegtran's operation that stores an upright photo as each orientation says it is stored.
STORED = {
    1: [],
    2: ["-flip", "horizontal"],
    3: ["-rotate", "180"],
    4: ["-flip", "vertical"],
    5: ["-transpose"],
    6: ["-rotate", "270"],
    7: ["-transverse"],
    8: ["-rotate", "90"],
}
CUT = 32  # rows off each photo's height: two blocks, one above and one below, so that the lens' axis stays in the middle


def store(source, target, way):
    target.mkdir(parents=True)
    for photo in sorted(source.glob("*.jpg")):
        width, height = Image.open(photo).size
        cut = target / ("cut-" + photo.name)
        subprocess.run(["jpegtran", "-perfect", "-crop", f"{width}x{height - CUT}+0+{CUT // 2}", "-outfile", cut, photo], check=True)
        subprocess.run(["jpegtran", "-perfect", *STORED[way], "-outfile", target / photo.name, cut], check=True)
        cut.unlink()
    subprocess.run(["exiftool", "-q", "-n", "-overwrite_original", f"-Orientation={way}", target], check=True)


def centres(workspace):
    """By the photos' names without suffix: mirrored ones are imported as PNG."""
    return {pathlib.Path(name).stem: -r.T @ t for name, (r, t) in read_poses(workspace / "sparse" / "0").items()}


def aligned(a, b):
    """Points b after the similarity (without mirroring) that fits them to a best; Umeyama, PAMI 1991."""
    ma, mb = a.mean(0), b.mean(0)
    u, s, vt = np.linalg.svd((a - ma).T @ (b - mb))
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    scale = np.trace(np.diag(s) @ sign) / ((b - mb) ** 2).sum()
    return scale * (b - mb) @ (u @ sign @ vt).T + ma


def thumbnails(workspace):
    page = (workspace / "report.html").read_text()
    found = re.findall(r'src="data:image/jpeg;base64,([A-Za-z0-9+/=]+)"', page)
    return [np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("L"), float) for data in found]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=pathlib.Path)
    parser.add_argument("images", type=pathlib.Path)
    parser.add_argument("work", type=pathlib.Path)
    parser.add_argument("--ways", default="1,2,3,4,5,6,7,8")
    arguments = parser.parse_args()
    has_failed = False
    reference = None
    for way in [int(text) for text in arguments.ways.split(",")]:
        folder = arguments.work / f"way{way}"
        images = folder / "images"
        if not images.exists():
            store(arguments.images, images, way)
        workspace = folder / "scan"
        log = folder / "log.txt"
        with log.open("w") as stream:
            code = subprocess.run([arguments.program.resolve(), "automatic_scanner", "--workspace_path", workspace, "--image_path",
                                   images, "--until", "split"], stdout=stream, stderr=subprocess.STDOUT).returncode
        if code != 0:
            print(f"way {way}: exit code {code}, see {log}", flush=True)
            has_failed = True
            continue
        here, pictures = centres(workspace), thumbnails(workspace)
        if reference is None:
            reference = here, pictures
        names = sorted(set(here) & set(reference[0]))
        a = np.array([reference[0][n] for n in names])
        spread = np.sqrt(((a - a.mean(0)) ** 2).sum(1).mean())
        far = 100 * np.linalg.norm(aligned(a, np.array([here[n] for n in names])) - a, axis=1) / spread
        same_size = len(pictures) == len(reference[1]) and all(p.shape == q.shape for p, q in zip(pictures, reference[1]))
        worst = max((np.abs(p - q).mean() for p, q in zip(pictures, reference[1])), default=np.inf) if same_size else np.inf
        is_right = len(here) == len(reference[0]) and np.median(far) < .1 and worst < 8
        has_failed = has_failed or not is_right
        print(f"way {way}: {len(here)} photos, centres {np.median(far):.4f} / {far.max():.4f} %, "
              f"{len(pictures)} pictures, they differ by {worst:.2f} at most{'' if is_right else '  WRONG'}", flush=True)
    sys.exit(1 if has_failed else 0)


if __name__ == "__main__":
    main()
