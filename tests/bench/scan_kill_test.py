#!/usr/bin/python3
"""Kills `s2gs automatic_scanner` at random moments and compares what it ends with to a run that nobody disturbed.

usage: scan_kill_test.py S2GS IMAGES WORK [--kills N] [--seed N] [--iterations N] [--size PX] [--share_features]
                         [--keep NAME ...]

One run goes through undisturbed in WORK/straight. In WORK/killed each run is killed (SIGKILL, of s2gs alone) at a
random moment of the pipeline: moments are drawn evenly over the undisturbed run's time and taken in order; a kill waits
for the stage that ran at its moment to begin, then for as long as that stage had run by then. The last run is left
alone. Poses, models, masks, depth and normal maps, the Gaussians and the mesh must be the same, bit for bit, and no
temporary file may be left. COLMAP 3.8's extractor makes a few descriptors in 100,000 differently from run to run:
--share_features gives the undisturbed run's database to the killed ones, which are then killed in later stages only.
"""
import argparse, os, random, re, shutil, signal, subprocess, sys, threading, time

COMPARED = ["split/labels.json", "sparse", "turntable.json", "masks", "s2gs/point_cloud.ply", "dense/0/images", "dense/0/sparse",
            "dense/0/stereo", "dense/0/masks", "dense/0/meshed-tsdf.ply"]
STAGE = re.compile(r"\] (\w+): runs \(")


def command(args, workspace):
    return [args.s2gs, "automatic_scanner", "--workspace_path", workspace, "--image_path", args.images_used,
            "--quality", "low", "--use_gpu", "0", "--num_iterations", str(args.iterations), "--max_image_size",
            str(args.size), "--force", "1"]


class Run:
    """A run of the scanner, whose stages are watched."""

    def __init__(self, args, workspace):
        self.started = time.time()
        self.stages = []  # name, seconds since the start
        self.changed = threading.Condition()
        self.lines = []
        self.has_ended = False
        self.process = subprocess.Popen(command(args, workspace), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
                                        text=True)
        self.reader = threading.Thread(target=self.read)
        self.reader.start()

    def read(self):
        for line in self.process.stderr:
            self.lines.append(line)
            stage = STAGE.search(line)
            if stage:
                with self.changed:
                    self.stages.append((stage.group(1), time.time() - self.started))
                    self.changed.notify()
        with self.changed:
            self.has_ended = True
            self.changed.notify()

    def wait_for(self, stage):
        """Whether the stage began."""
        with self.changed:
            self.changed.wait_for(lambda: self.has_ended or stage in [name for name, _ in self.stages])
            return stage in [name for name, _ in self.stages]

    def wait_within(self, stage, seconds):
        """For so long, or until the stage is over."""
        with self.changed:
            self.changed.wait_for(
                lambda: self.has_ended or self.stages and stage not in ("", self.stages[-1][0]), timeout=seconds)

    def finish(self):
        code = self.process.wait()
        self.reader.join()
        if code != 0:
            sys.exit("".join(self.lines[-20:]) + f"automatic_scanner ended with {code}")
        return time.time() - self.started


def files_of(workspace):
    files = []
    for name in COMPARED:
        path = os.path.join(workspace, name)
        if os.path.isdir(path):
            for folder, _, names in os.walk(path):
                files += [os.path.relpath(os.path.join(folder, n), workspace) for n in names]
        elif os.path.exists(path):
            files.append(name)
    return sorted(files)


def content(path):
    with open(path, "rb") as stream:
        return stream.read()


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("s2gs")
    parser.add_argument("images")
    parser.add_argument("work")
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--iterations", type=int, default=300)
    parser.add_argument("--size", type=int, default=100)
    parser.add_argument("--share_features", action="store_true")
    parser.add_argument("--keep", nargs="*", default=[""], help="photos whose names begin so")
    args = parser.parse_args()

    shutil.rmtree(args.work, ignore_errors=True)
    args.images_used = os.path.join(args.work, "images")
    os.makedirs(args.images_used)
    for name in os.listdir(args.images):
        if any(name.startswith(start) for start in args.keep):
            shutil.copy(os.path.join(args.images, name), args.images_used)
    straight = os.path.join(args.work, "straight")
    killed = os.path.join(args.work, "killed")

    run = Run(args, straight)
    total = run.finish()
    timeline = [("", 0.0)] + run.stages
    print(f"undisturbed: {total:.1f} s, " + ", ".join(f"{name} from {at:.1f}" for name, at in run.stages), flush=True)

    first_moment = 0.0
    if args.share_features:
        first_moment = dict(run.stages)["motion_splitter"]
        os.makedirs(killed)
        shutil.copy(os.path.join(straight, "database.db"), killed)
    rng = random.Random(args.seed)
    done = 0
    killed_at = {}  # how far into a stage it was killed last
    for moment in sorted(rng.uniform(first_moment, total) for _ in range(args.kills)):
        stage, begin = [entry for entry in timeline if entry[1] <= moment][-1]
        run = Run(args, killed)
        if stage and not run.wait_for(stage):
            run.finish()  # the kill before came so late that the stage was done
            print(f"  {stage} was done", flush=True)
            continue
        # Training goes on from its checkpoints: it has no more than the rest before it.
        into = moment - begin
        begun = killed_at.get(stage, 0) if stage == "gaussian_trainer" else 0
        killed_at[stage] = into
        run.wait_within(stage, into - begun)
        run.process.send_signal(signal.SIGKILL)
        run.process.wait()
        run.reader.join(timeout=0.2)  # children that outlive it keep the pipe
        done += 1
        print(f"  killed {moment - begin:.2f} s into {stage or 'the start'}", flush=True)
    run = Run(args, killed)
    run.finish()

    expected = files_of(straight)
    found = files_of(killed)
    different = [name for name in expected if name in found
                 and content(os.path.join(straight, name)) != content(os.path.join(killed, name))]
    missing = sorted(set(expected) ^ set(found))
    leftovers = [os.path.join(folder, name) for folder, _, names in os.walk(killed) for name in names
                 if ".s2gs-tmp-" in name or ".extracting" in name]
    for name in different:
        print("differs:", name)
    for name in missing:
        print("in one only:", name)
    for name in leftovers:
        print("left over:", name)
    print(f"{done} of {args.kills} kills; {len(expected)} files compared, {len(different)} differ, {len(missing)} in one "
          f"only, {len(leftovers)} left over")
    if not os.path.exists(os.path.join(straight, "dense/0/meshed-tsdf.ply")):
        sys.exit("no mesh was made")
    sys.exit(1 if different or missing or leftovers or done == 0 else 0)


main()
