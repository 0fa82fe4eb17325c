#!/usr/bin/python3
"""Kills `s2gs automatic_scanner` at random moments and compares what it ends with to a run that nobody disturbed.

usage: scan_kill_test.py S2GS IMAGES WORK [--kills N] [--seed N] [--iterations N] [--size PX] [--share_features]
                         [--keep NAME ...] [--record]

One run goes through undisturbed in WORK/straight. In WORK/killed each run is killed (SIGKILL, of s2gs alone) after a random
time, evenly drawn between nothing and a fifth more than the longest stage took undisturbed, and the same command is given
again: it goes on where it was, until a run ends by itself. Then its files are compared, and another scan begins, until there
were enough kills; the last scan is left to end. Poses, models, masks, depth and normal maps, the Gaussians and the mesh must
be the same, bit for bit, after every scan, and no temporary file may be left. COLMAP 3.8's extractor makes a few descriptors
in 100,000 differently from run to run: --share_features gives the undisturbed run's database to the killed ones, which are
then killed in later stages only. --record leaves the counts in tests/bench/results/safety.
"""
import argparse, collections, os, random, re, shutil, signal, subprocess, sys, threading, time

sys.dont_write_bytecode = True
import safety

COMPARED = ["imported", "split/labels.json", "sparse", "turntable.json", "masks", "s2gs/point_cloud.ply", "dense/0/images", "dense/0/sparse",
            "dense/0/stereo", "dense/0/masks", "dense/0/meshed-tsdf.ply", "dense/0/textured-tsdf.glb"]
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

    def ends_within(self, seconds):
        """Whether it ended by itself."""
        with self.changed:
            self.changed.wait_for(lambda: self.has_ended, timeout=seconds)
            return self.has_ended

    def kill(self):
        """Returns the stage in which it was."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        self.reader.join(timeout=0.2)  # children that outlive it keep the pipe
        return self.stages[-1][0] if self.stages else "no stage"

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


def compare(straight, killed):
    """Counts of files that were compared and of what is wrong with them, which is printed."""
    expected, found = files_of(straight), files_of(killed)
    different = [name for name in expected if name in found
                 and content(os.path.join(straight, name)) != content(os.path.join(killed, name))]
    missing = sorted(set(expected) ^ set(found))
    leftovers = [os.path.join(folder, name) for folder, _, names in os.walk(killed) for name in names
                 if ".s2gs-tmp-" in name or ".extracting" in name]
    for what, names in (("differs", different), ("in one only", missing), ("left over", leftovers)):
        for name in names:
            print(f"{what}: {name}")
    return {"files": len(expected), "differ": len(different), "in one only": len(missing), "left over": len(leftovers)}


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
    parser.add_argument("--record", action="store_true")
    parser.add_argument("--variant", default="", help="what is scanned, for the record")
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
    print(f"undisturbed: {total:.1f} s, " + ", ".join(f"{name} from {at:.1f}" for name, at in run.stages), flush=True)

    begins = [at for _, at in run.stages] + [total]
    longest = max(end - begin for begin, end in zip([0] + begins, begins))

    def begin_scan():
        shutil.rmtree(killed, ignore_errors=True)
        if args.share_features:
            os.makedirs(killed)
            shutil.copy(os.path.join(straight, "database.db"), killed)

    rng = random.Random(args.seed)
    stages = collections.Counter()
    sums = collections.Counter()
    while True:
        begin_scan()
        run = Run(args, killed)
        while sum(stages.values()) < args.kills and not run.ends_within(rng.uniform(0, 1.2 * longest)):
            stages[run.kill()] += 1
            run = Run(args, killed)
        run.finish()
        found = compare(straight, killed)
        sums.update(found)
        sums["scans"] += 1
        print(f"scan {sums['scans']}: {sum(stages.values())} kills so far, {found['files']} files compared, {found['differ']} differ, "
              f"{found['in one only']} in one only, {found['left over']} left over", flush=True)
        if sum(stages.values()) >= args.kills:
            break
    faults = sums["differ"] + sums["in one only"] + sums["left over"]
    print(f"{sum(stages.values())} kills ({', '.join(f'{n} in {name}' for name, n in stages.items())}) in {sums['scans']} scans; "
          f"{sums['files']} files compared, {sums['differ']} differ, {sums['in one only']} in one only, {sums['left over']} left over")
    if args.record:
        figures = {"kills": sum(stages.values()), **{name: sums[name] for name in ("scans", "files", "differ", "in one only", "left over")}}
        before = safety.recorded("kills", args.variant)
        safety.record("kills", args.variant, f"tests/bench/scan_kill_test.py build/cpu/s2gs IMAGES WORK --kills {args.kills} --seed N --record",
                      int(faults > 0), {name: value + before.get(name, 0) for name, value in figures.items()})
    if not os.path.exists(os.path.join(straight, "dense/0/meshed-tsdf.ply")):
        sys.exit("no mesh was made")
    sys.exit(1 if faults or not stages else 0)


main()
