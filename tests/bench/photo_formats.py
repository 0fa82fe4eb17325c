#!/usr/bin/python3
"""Scans one photo set as JPEG, PNG and TIFF of 16 bits, WebP, HEIC and as a video, and compares the poses.

usage: photo_formats.py PROGRAM IMAGES WORK [--formats jpg,jpg-again,png16,tiff16,webp,heic,video]

IMAGES are JPEGs. `automatic_scanner --until split` poses each set, and per set this says: photos with a pose, and the distance of
camera centres from those of the first set, after the similarity that fits them best, in % of the cameras' spread, median and
largest. Exit code 1 where a photo has no pose that the first set has, or the median is above .1 %.

PNG and TIFF hold what the JPEGs decode to; WebP and HEIC are of quality 95; the video is H.264 of constant quality 10, a photo a
frame, and each of its intervals one frame long. Needs ffmpeg, heif-enc, and numpy and PIL.
"""
import argparse
import pathlib
import subprocess
import sys

import numpy as np

from exif_ways import aligned, centres

SUFFIXES = {"jpg": ".jpg", "png16": ".png", "tiff16": ".tiff", "webp": ".webp", "heic": ".heic"}


def store(photos, target, form):
    """Returns what --image_path gets."""
    target.mkdir(parents=True)
    if form == "video":
        listing = target / "photos.txt"
        listing.write_text("".join(f"file '{photo.resolve()}'\nduration 0.04\n" for photo in photos))
        subprocess.run(["ffmpeg", "-v", "error", "-f", "concat", "-safe", "0", "-i", listing, "-r", "25", "-c:v", "libx264", "-crf", "10",
                        "-pix_fmt", "yuv420p", target / "turn.mp4"], check=True)
        return target / "turn.mp4"
    kind = form.split("-")[0]
    for photo in photos:
        path = target / (photo.stem + SUFFIXES[kind])
        if kind == "jpg":
            path.write_bytes(photo.read_bytes())
        elif kind == "heic":
            subprocess.run(["heif-enc", "-q", "95", "-o", path, photo], check=True, stdout=subprocess.DEVNULL)
        elif kind == "webp":
            subprocess.run(["ffmpeg", "-v", "error", "-i", photo, "-c:v", "libwebp", "-quality", "95", path], check=True)
        else:
            subprocess.run(["ffmpeg", "-v", "error", "-i", photo, "-pix_fmt", "rgb48le" if kind == "tiff16" else "rgb48be", path], check=True)
    return target


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=pathlib.Path)
    parser.add_argument("images", type=pathlib.Path)
    parser.add_argument("work", type=pathlib.Path)
    parser.add_argument("--formats", default="jpg,jpg-again,png16,tiff16,webp,heic,video")
    arguments = parser.parse_args()
    photos = sorted(arguments.images.glob("*.jpg"))
    has_failed = False
    reference = None
    for form in arguments.formats.split(","):
        folder = arguments.work / form
        images = folder / "photos"
        source = (images / "turn.mp4" if form == "video" else images) if images.exists() else store(photos, images, form)
        workspace = folder / "scan"
        log = folder / "log.txt"
        with log.open("w") as stream:
            code = subprocess.run([arguments.program.resolve(), "automatic_scanner", "--workspace_path", workspace, "--image_path",
                                   source, "--video_frames", str(len(photos)), "--until", "split"],
                                  stdout=stream, stderr=subprocess.STDOUT).returncode
        if code != 0:
            print(f"{form}: exit code {code}, see {log}", flush=True)
            has_failed = True
            continue
        here = centres(workspace)
        # Frames are numbered in the photos' order.
        if form == "video":
            here = {photos[i].stem: here[name] for i, name in enumerate(sorted(here))} if len(here) == len(photos) else {}
        if reference is None:
            reference = here
        names = sorted(set(here) & set(reference))
        if len(names) < len(reference):
            print(f"{form}: {len(names)} of {len(reference)} photos  WRONG", flush=True)
            has_failed = True
            continue
        a = np.array([reference[n] for n in names])
        spread = np.sqrt(((a - a.mean(0)) ** 2).sum(1).mean())
        far = 100 * np.linalg.norm(aligned(a, np.array([here[n] for n in names])) - a, axis=1) / spread
        is_right = np.median(far) < .1
        has_failed = has_failed or not is_right
        print(f"{form}: {len(here)} photos, centres {np.median(far):.4f} / {far.max():.4f} %{'' if is_right else '  WRONG'}", flush=True)
    sys.exit(1 if has_failed else 0)


if __name__ == "__main__":
    main()
