"""What the hostile cases stand on: a tiny finished workspace, a folder for each case, runs that are watched."""
import hashlib
import json
import os
import pathlib
import resource
import shutil
import signal
import struct
import subprocess
import time

import numpy as np

MAX_CPU_SECONDS = 10   # of a run that has nothing to compute: a loop over what was not checked
MAX_WALL_SECONDS = 120  # of any run: waits for ever count as hangs on a loaded machine too
IMAGE_PATTERNS = ["s1_a000", "s1_a036", "s1_a072", "s1_a108", "s2_a000", "s2_a036", "s2_a072", "s2_a108"]


def quaternion(R):
    """w, x, y, z of a rotation matrix, by the largest eigenvector (Bar-Itzhack)."""
    m = R
    k = np.array([[m[0, 0] - m[1, 1] - m[2, 2], 0, 0, 0], [m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], 0, 0],
                  [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1], 0],
                  [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], m[0, 0] + m[1, 1] + m[2, 2]]]) / 3
    x, y, z, w = np.linalg.eigh(k)[1][:, -1]
    return np.array([w, x, y, z]) * (1 if w >= 0 else -1)


def write_model(folder, images, camera="1 PINHOLE {width} {height} {f} {f} {cx} {cy}", size=(400, 400), focal=480.0):
    """A text model: `images` are (name, 4 x 4 matrix)."""
    folder.mkdir(parents=True, exist_ok=True)
    width, height = size
    (folder / "cameras.txt").write_text(camera.format(width=width, height=height, f=focal, cx=width / 2, cy=height / 2) + "\n")
    lines = []
    for i, (name, pose) in enumerate(images):
        numbers = " ".join(repr(float(v)) for v in [*quaternion(pose[:3, :3]), *pose[:3, 3]])
        lines.append(f"{i + 1} {numbers} 1 {name}\n\n")
    (folder / "images.txt").write_bytes("".join(lines).encode("utf-8", "surrogateescape"))
    (folder / "points3D.txt").write_text("")


def write_binary_model(folder, name, width=400, height=400, model=1, params=(480.0, 480.0, 200.0, 200.0)):
    """A binary model of one image, whose name is bytes."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cameras.bin").write_bytes(struct.pack("<QIiQQ", 1, 1, model, width, height) +
                                         struct.pack(f"<{len(params)}d", *params))
    (folder / "images.bin").write_bytes(struct.pack("<QI7dI", 1, 1, 1, 0, 0, 0, 0, 0, 3, 1) + name + b"\0" +
                                        struct.pack("<Q", 0))
    (folder / "points3D.bin").write_bytes(struct.pack("<Q", 0))


def exact_workspace(examples, photos, workspace):
    """Photos of the shipped example and a workspace with their exact poses."""
    scene = json.loads((examples / "gt" / "scene.json").read_text())
    photos.mkdir(parents=True)
    chosen = []
    for image in scene["images"]:
        name = pathlib.PurePosixPath(image["file"]).name
        if pathlib.Path(name).stem in IMAGE_PATTERNS and (examples / image["file"]).exists():
            shutil.copyfile(examples / image["file"], photos / name)
            chosen.append((name, image))
    assert len(chosen) >= 6, "the example's photos are not where they were"
    size = (scene["width"], scene["height"])
    camera = f"1 PINHOLE {size[0]} {size[1]} {scene['fx']} {scene['fy']} {scene['cx']} {scene['cy']}"
    turntable = {"version": 1, "axis": {"point": scene["axis_point"], "direction": scene["axis_direction"]},
                 "stations": 1 + max(image["station"] for _, image in chosen), "scale_observable": True, "units": "sfm",
                 "images": []}
    objects, statics = [], []
    for name, image in chosen:
        world = np.array(image["world_to_camera"], float)
        turn = np.array(image["object_to_world"], float)
        objects.append((name, world @ turn))
        statics.append((name, world))
        turntable["images"].append({"name": name, "station": image["station"], "angle_deg": image["angle_deg"],
                                    "object_to_world": turn.tolist()})
    write_model(workspace / "sparse" / "0", objects, camera)
    write_model(workspace / "sparse" / "static", statics, camera)
    (workspace / "turntable.json").write_text(json.dumps(turntable))


def fingerprint(folder):
    """Path to content of all that lies in a folder: files by their hash, links by where they lead."""
    prints = {}
    for path in sorted(folder.rglob("*")):
        key = os.fsencode(str(path.relative_to(folder)))
        if path.is_symlink():
            prints[key] = "link " + os.readlink(path)
        elif path.is_file():
            prints[key] = hashlib.sha256(path.read_bytes()).hexdigest()
    return prints


class Run:
    """How a run of the program ended."""

    def __init__(self, arguments, code, text, wall_seconds, cpu_seconds, is_hung, cpu_after_interrupt=None):
        self.arguments, self.code, self.text = arguments, code, text
        self.wall_seconds, self.cpu_seconds, self.is_hung = wall_seconds, cpu_seconds, is_hung
        self.cpu_after_interrupt = cpu_after_interrupt  # of its threads together; None: not measured


def catches(pid, number):
    """Whether a process has a handler of a signal."""
    try:
        status = pathlib.Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False
    mask = int(next(line.split()[1] for line in status.splitlines() if line.startswith("SigCgt:")), 16)
    return bool(mask >> (number - 1) & 1)


def cpu_seconds_of(pid):
    """What a process has computed so far, with its system calls."""
    fields = pathlib.Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Sandbox:
    """A case's folder: `scan` is the workspace, in which the program may write; all else must stay as it is."""

    def __init__(self, program, folder, base):
        self.program, self.folder, self.base = program, folder, base
        self.scan = folder / "scan"
        self.photos = folder / "photos"
        shutil.copytree(base / "photos", self.photos)

    def use_workspace(self):
        """The finished workspace."""
        shutil.copytree(self.base / "scan", self.scan, symlinks=True)
        return self.scan

    def forget(self, *stages):
        for stage in stages:
            (self.scan / "s2gs" / "stages" / f"{stage}.json").unlink(missing_ok=True)

    def outside(self):
        own = os.fsencode("scan")
        return {key: value for key, value in fingerprint(self.folder).items()
                if key != own and not key.startswith(own + b"/")}

    def run(self, arguments, env=None, file_limit=None, interrupt_after=None, interrupt_at_cpu=None, user=None, stdout=None):
        """Runs the program. It gets SIGINT so many seconds after it catches it (`interrupt_after`), or when it has computed
        for so many (`interrupt_at_cpu`)."""
        environment = dict(os.environ, LC_ALL="C.UTF-8", OMP_NUM_THREADS="2")
        environment.update(env or {})
        environment = {key: value for key, value in environment.items() if value is not None}

        def prepare():
            if file_limit is not None:
                resource.setrlimit(resource.RLIMIT_FSIZE, (file_limit, file_limit))
            if user is not None:
                os.setgroups([])
                os.setgid(user)
                os.setuid(user)

        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        started = time.time()
        log = self.folder.parent / (self.folder.name + ".log")
        with open(log, "wb") as output:
            process = subprocess.Popen([self.program] + [os.fspath(a) for a in arguments], stdin=subprocess.DEVNULL,
                                       stdout=stdout or output, stderr=output, env=environment, cwd=self.folder,
                                       preexec_fn=prepare, start_new_session=True)
            is_hung = False
            cpu_at_interrupt = None
            try:
                if interrupt_at_cpu is not None:
                    while process.poll() is None and (cpu_at_interrupt := cpu_seconds_of(process.pid)) < interrupt_at_cpu \
                            and time.time() - started < MAX_WALL_SECONDS:
                        time.sleep(0.02)
                    if process.poll() is None:
                        process.send_signal(signal.SIGINT)
                if interrupt_after is not None:
                    # A machine that others keep busy may take seconds to load it.
                    while process.poll() is None and not catches(process.pid, signal.SIGINT) \
                            and time.time() - started < MAX_WALL_SECONDS:
                        time.sleep(0.02)
                    try:
                        process.wait(interrupt_after)
                    except subprocess.TimeoutExpired:
                        process.send_signal(signal.SIGINT)
                process.wait(MAX_WALL_SECONDS)
            except subprocess.TimeoutExpired:
                is_hung = True
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        text = log.read_bytes().decode("utf-8", "backslashreplace")
        return Run(arguments, process.returncode, text, time.time() - started, cpu, is_hung,
                   None if cpu_at_interrupt is None else cpu - cpu_at_interrupt)


def fake_colmap(path, extractor, help_text=True):
    """A shell script in colmap's place. `extractor`: shell commands of its feature_extractor."""
    answer = ("printf '%s\\n' 'COLMAP 3.8 -- fake (Commit abc without CUDA)' 'Available commands:' '  feature_extractor' "
              "'  mapper'; exit 0") if help_text else "kill -SEGV $$"
    options = ["database_path", "image_path", "image_list_path", "ImageReader.camera_model", "ImageReader.single_camera",
               "ImageReader.single_camera_per_folder"] + ["SiftExtraction." + name for name in
                                                           ["max_num_features", "use_gpu", "num_threads"]]
    listing = "\n".join(f"  --{name} arg" for name in options)
    path.write_text(f"#!/bin/sh\nif [ \"$1\" = help ]; then {answer}; fi\n{extractor}\n"
                    .replace("@OPTIONS@", f"if [ \"$2\" = -h ]; then cat <<'END'\n{listing}\nEND\nexit 0; fi"))
    path.chmod(0o755)
    return path


def prepare_base(program, examples, folder):
    """The finished workspace that all cases share."""
    exact_workspace(examples, folder / "photos", folder / "scan")
    common = ["--workspace_path", str(folder / "scan"), "--use_gpu", "0", "--log_level", "error"]
    images = ["--image_path", str(folder / "photos")]
    for arguments in (["gaussian_trainer", *common, *images, "--Train.num_iterations", "40", "--max_image_size", "96",
                       "--Init.num_random_points", "2000", "--Init.min_points", "1000"],
                      ["gaussian_renderer", *common, *images]):
        done = subprocess.run([program] + arguments, capture_output=True, text=True)
        if done.returncode != 0:
            raise SystemExit(f"{arguments[0]}: exit code {done.returncode}: {done.stderr.strip()}")
