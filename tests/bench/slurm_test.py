#!/usr/bin/python3
"""Scans eight small objects as an array on a Slurm cluster of one machine, and compares their files to those of local runs.

usage: slurm_test.py S2GS IMAGES WORK [--patience SECONDS]     as root, with Debian's slurm-wlm and munge; IMAGES: examples/falcon_desk/images

Starts munged, slurmctld and slurmd in WORK/cluster, on ports of their own, and ends them. Each object is 14 of the photos at
240 px, 7 of each of two stations. `s2gs scan_batch` scans all of them here; the array, queued by examples/cluster/submit.sh,
scans them again with the same features (COLMAP 3.8's extractor makes a few descriptors in 100,000 differently from run to
run). Of two tasks that run, one is queued again by `scontrol requeue`, as by preemption; of the other the scan is killed
(SIGKILL), after which it is queued again. All must end well, no file may differ and none be left over.
"""
import argparse, getpass, hashlib, os, pathlib, shutil, signal, socket, subprocess, sys, time

import cv2

sys.dont_write_bytecode = True
ROOT = pathlib.Path(__file__).resolve().parents[2]
COMPARED = ["split/labels.json", "sparse", "turntable.json", "masks", "s2gs/point_cloud.ply", "dense/0/images", "dense/0/sparse",
            "dense/0/stereo", "dense/0/masks", "dense/0/meshed-tsdf.ply", "dense/0/textured-tsdf.glb"]
OPTIONS = "--quality low --use_gpu 0 --num_iterations 60 --max_image_size 48 --force 1"
OBJECTS = 8
CONFIG = """ClusterName=one
SlurmctldHost={host}
SlurmctldPort=26817
SlurmdPort=26818
AuthType=auth/munge
AuthInfo=socket={work}/munge/socket
SlurmUser=root
SlurmdUser=root
StateSaveLocation={work}/state
SlurmdSpoolDir={work}/spool
SlurmctldPidFile={work}/slurmctld.pid
SlurmdPidFile={work}/slurmd.pid
SlurmctldLogFile={work}/slurmctld.log
SlurmdLogFile={work}/slurmd.log
ProctrackType=proctrack/pgid
TaskPlugin=task/none
MpiDefault=none
ReturnToService=2
SchedulerType=sched/backfill
SchedulerParameters=batch_sched_delay=1,sched_interval=2,bf_interval=2
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
JobRequeue=1
KillWait=5
MinJobAge=3600
NodeName={host} CPUs=2 RealMemory=2000 State=UNKNOWN
PartitionName=main Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""


class Cluster:
    """Slurm on this machine, while the block lasts."""

    def __init__(self, work):
        self.work = work

    def __enter__(self):
        shutil.rmtree(self.work, ignore_errors=True)
        munge = self.work / "munge"
        for folder in (munge, self.work / "state", self.work / "spool"):
            folder.mkdir(parents=True)
        (munge / "key").write_bytes(os.urandom(128))
        (munge / "key").chmod(0o600)
        config = self.work / "slurm.conf"
        config.write_text(CONFIG.format(host=socket.gethostname().split(".")[0], work=self.work))
        os.environ["SLURM_CONF"] = str(config)
        run("munged", "--force", f"--key-file={munge}/key", f"--socket={munge}/socket", f"--pid-file={munge}/pid",
            f"--log-file={munge}/log", f"--seed-file={munge}/seed")
        run("slurmctld")
        time.sleep(1)
        run("slurmd")
        for _ in range(30):
            if "idle" in output("sinfo", "--noheader", "--format=%T"):
                return self
            time.sleep(1)
        sys.exit(f"the node does not come up: see {self.work}")

    def __exit__(self, *_):
        for path in ("slurmd.pid", "slurmctld.pid", "munge/pid"):
            try:
                os.kill(int((self.work / path).read_text()), signal.SIGTERM)
            except (OSError, ValueError):
                pass


def run(*command, **more):
    subprocess.run([str(word) for word in command], check=True, **more)


def output(*command):
    return subprocess.run([str(word) for word in command], check=True, capture_output=True, text=True).stdout


def states(job):
    """State of each task, by its number in the array."""
    lines = output("scontrol", "show", "job", job, "--oneliner").splitlines()
    result = {}
    for line in lines:
        fields = dict(word.split("=", 1) for word in line.split() if "=" in word)
        if fields.get("ArrayTaskId", "").isdigit():
            result[int(fields["ArrayTaskId"])] = fields
    return result


def wait_until(job, is_so, seconds):
    begin = time.time()
    while time.time() - begin < seconds:
        tasks = states(job)
        if is_so(tasks):
            return tasks
        time.sleep(0.2)
    sys.exit(f"nothing happened for {seconds} s: {tasks}")


def pids_of(workspace):
    """Processes whose command line names a workspace."""
    pids = []
    for folder in pathlib.Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if str(workspace).encode() in words:
            pids.append(int(folder.name))
    return pids


def make_photos(images, work):
    for i in range(OBJECTS):
        folder = work / "photos" / f"object{i}"
        folder.mkdir(parents=True)
        for station in ("s2", "s3"):
            photos = sorted(pathlib.Path(images).glob(f"{station}_*.jpg"))
            for k in range(7):
                photo = photos[(2 * i + k) % len(photos)]
                small = cv2.resize(cv2.imread(str(photo)), (240, 240), interpolation=cv2.INTER_AREA)
                cv2.imwrite(str(folder / photo.name), small, [cv2.IMWRITE_JPEG_QUALITY, 95])


def write_list(work, name):
    path = work / f"{name}.csv"
    path.write_text("images,workspace,options\n" +
                    "".join(f"photos/object{i},{name}/object{i},{OPTIONS}\n" for i in range(OBJECTS)))
    return path


def hashes(workspace):
    result = {}
    for name in COMPARED:
        path = workspace / name
        for file in [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file()):
            result[str(file.relative_to(workspace))] = hashlib.sha256(file.read_bytes()).hexdigest()
    return result


def interrupt_two(job, work, patience):
    """Queues two running tasks again, one as preemption does, one after its scan was killed."""
    def in_training(task):
        return (work / "cluster_scans" / f"object{task - 1}" / "turntable.json").exists()

    tasks = wait_until(job, lambda now: any(t["JobState"] == "RUNNING" and in_training(i) for i, t in now.items()), patience)
    first = next(i for i, t in tasks.items() if t["JobState"] == "RUNNING" and in_training(i))
    run("scontrol", "requeue", f"{job}_{first}")
    print(f"task {first}: queued again while it ran")
    tasks = wait_until(job, lambda now: any(t["JobState"] == "RUNNING" and i != first and
                                            pids_of(work / "cluster_scans" / f"object{i - 1}") for i, t in now.items()), patience)
    second, pids = next((i, pids_of(work / "cluster_scans" / f"object{i - 1}")) for i, t in tasks.items()
                        if t["JobState"] == "RUNNING" and i != first and pids_of(work / "cluster_scans" / f"object{i - 1}"))
    for pid in pids:
        os.kill(pid, signal.SIGKILL)
    wait_until(job, lambda now: now[second]["JobState"] not in ("RUNNING", "COMPLETING"), patience)
    run("scontrol", "requeue", f"{job}_{second}")
    print(f"task {second}: scan killed, queued again")
    return first, second


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("s2gs")
    parser.add_argument("images")
    parser.add_argument("work")
    parser.add_argument("--patience", type=float, default=900, help="without anything that is waited for, before it fails")
    args = parser.parse_args()
    if getpass.getuser() != "root":
        sys.exit("slurmd starts jobs as root only")
    work = pathlib.Path(args.work).resolve()
    shutil.rmtree(work, ignore_errors=True)
    make_photos(args.images, work)
    s2gs = pathlib.Path(args.s2gs).resolve()
    run(s2gs, "scan_batch", "--list", write_list(work, "local"), stdout=subprocess.DEVNULL)
    for i in range(OBJECTS):
        source, target = (work / name / f"object{i}" for name in ("local", "cluster_scans"))
        (target / "s2gs" / "stages").mkdir(parents=True)
        for name in ("database.db", "s2gs/stages/feature_extractor.json"):
            shutil.copy2(source / name, target / name)
    scans = write_list(work, "cluster_scans")
    with Cluster(work / "cluster"):
        text = subprocess.run([ROOT / "examples/cluster/submit.sh", scans, "--gpus=0", "--cpus-per-task=1", "--mem=900M"],
                              env={**os.environ, "S2GS": str(s2gs)}, cwd=work, check=True, capture_output=True, text=True).stdout
        print(text, end="")
        job, page = (word.strip(";\n") for word in (text.split("job ")[1].split(";")[0], text.split("job ")[2]))
        interrupted = interrupt_two(job, work, args.patience)
        tasks = wait_until(job, lambda now: len(now) == OBJECTS and
                           all(t["JobState"] not in ("PENDING", "RUNNING", "COMPLETING", "REQUEUED") for t in now.values()), 4 * args.patience)
        for i, task in sorted(tasks.items()):
            print(f"task {i}: {task['JobState']}, queued again {task['Restarts']} times")
        for _ in range(120):
            if "JobState=COMPLETED" in output("scontrol", "show", "job", page):
                break
            time.sleep(0.5)
    faults = [f"task {i} {t['JobState']}" for i, t in tasks.items() if t["JobState"] != "COMPLETED"]
    faults += [f"task {i} was not queued again" for i in interrupted if tasks[i]["Restarts"] == "0"]
    if not (work / "cluster_scans" / "index.html").exists():
        faults.append("no index.html")
    count = 0
    for i in range(OBJECTS):
        one, other = (hashes(work / name / f"object{i}") for name in ("local", "cluster_scans"))
        count += len(one)
        faults += [f"object{i}/{name} differs" for name in sorted(one.keys() | other.keys()) if one.get(name) != other.get(name)]
        faults += [f"{p} is left over" for p in (work / "cluster_scans" / f"object{i}").rglob(".s2gs-tmp-*")]
    print("\n".join(faults) if faults else f"{OBJECTS} scans, {count} files compared, none differs")
    return 1 if faults else 0


sys.exit(main())
