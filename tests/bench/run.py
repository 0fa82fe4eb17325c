#!/usr/bin/env python3
"""Measures: runs suites over scenes and seeds, leaves one small JSON a run, and writes BENCHMARK.md anew.

usage: run.py [SUITE ...] [--scenes NAME ...] [--variants WORD] [--seeds N ...] [--gpu] [--program S2GS] [--tools FOLDER] [--python PYTHON]
              [--data FOLDER] [--results FOLDER] [--work FOLDER] [--again] [--commit TEXT] [--no_report]

  kernels  times of a training step and of fusion (step_bench or gpu_step_bench, tsdf_bench; in --tools)
  train    exact poses to a model, photos never seen: in mode s2gs, and in mode masks with perfect masks
  mesh     the models of `train` to masks, depth and mesh, scored against the truth
  poses    photos to poses: automatic_scanner --until split, scored against the truth; of falcon_desk also by COLMAP
           alone with perfect masks
  scan     photos to mesh: automatic_scanner, scored against the truth
  safety   hostile cases in full, killed scans, fuzz targets (which need clang): no scenes, CPU only
Without suite names the half of BENCHMARK.md that this machine can make: all of them, or with --gpu the first three.
Without --scenes those of SUITES; those that are not there are named at the end. A scene is looked for in DATA/NAME, then
where scenes.json says. The program is that of build/cpu or build/tests. What is written in Python needs what
requirements.txt names: where neither --python nor this Python has it, a venv is made in build/bench/venv (from the
network, once). train, mesh and kernels need this folder, Python with numpy, and the static trainer (preset `trainer`): a
bare GPU node does. Training starts from DATA/NAME/points/{object,static} (COLMAP models that SfM made) where they are, else
from the models that `poses` or `scan` left in WORK, which run before it; else at random.

A run whose result is there from the same commit and data is skipped, so that the same command goes on where it was.
Results hold CPU and wall seconds; on a machine that other work shares (`load` is that before the run) neither is a
measurement.
"""
import argparse
import json
import os
import pathlib
import platform
import re
import resource
import shutil
import subprocess
import sys
import time

import report
import results
import scenes

# What each suite runs when no scenes are named, small ones on the CPU, the shortest first; suites in this order, as training
# starts from points that the poses left, and the kernels' steps are of what was trained.
SUITES = {
    'poses': (['example', 'box_small', 'rock_small', 'rock', 'ogre_fixed', 'rubik_cube', 'green_apple', 'box', 'large', 'knot',
               'vase', 'dome', 'hand', 'shiny', 'falcon_desk'],) * 2,
    'train': (['example'], ['falcon_desk', 'knot', 'box', 'rock']),
    'mesh': (['example'], ['falcon_desk', 'knot', 'box', 'rock']),
    'kernels': (['example'], ['falcon_desk']),
    'scan': (['example', 'box_small', 'falcon_desk'], ['falcon_desk', 'knot', 'box', 'rock', 'vase', 'flowerpot']),
}
SAFETY = ['hostile', 'kills', 'fuzz']  # parts of suite `safety`
BESIDE_COLMAP = ['falcon_desk']  # whose poses COLMAP alone is measured at, too: minutes each
# Enough for what a change broke to show; a fault of chance needs nights.
KILLS, FUZZ_SECONDS = 20, 25
ON_BARE_NODE = ('kernels', 'train', 'mesh')
BUILDS = [scenes.REPOSITORY / 'build' / name for name in ('cpu', 'tests')]
HERE = scenes.HERE
VENV = scenes.REPOSITORY / 'build/bench/venv'
# Courses that a CPU ends in minutes; a GPU runs the trainer's own defaults.
CPU_COURSE = ['--max_image_size', '160', '--Train.num_iterations', '1500', '--Train.max_gaussians', '25000']


class Failed(Exception):
    """A command ended with another code than 0."""

    def __init__(self, code):
        super().__init__(f'exit code {code}')
        self.code = code


def first_line(command):
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip().split('\n')[0]
    except (OSError, subprocess.CalledProcessError):
        return ''


def machine(gpu, named=None):
    cpu = platform.machine()
    if os.path.exists('/proc/cpuinfo'):
        found = re.search(r'model name\s*: (.*)', pathlib.Path('/proc/cpuinfo').read_text())
        cpu = found[1] if found else cpu
    cores = len(os.sched_getaffinity(0))
    card = first_line(['nvidia-smi', '--query-gpu=name', '--format=csv,noheader']) if gpu else None
    name = named or (card.replace('NVIDIA ', '').replace(' ', '-').lower() if card else f'cpu{cores}')
    return {'name': name, 'cpu': cpu, 'cores': cores, 'gpu': card}


def commit_of(repository):
    commit = first_line(['git', '-C', str(repository), 'rev-parse', '--short=10', 'HEAD'])
    changed = first_line(['git', '-C', str(repository), 'status', '--porcelain', '--', 'plugin', 'sfm_split', 's2gs', 'mesh'])
    return commit + ('+changes' if changed else '')


def has_modules(python, modules):
    try:
        return subprocess.run([python, '-c', f'import {modules}'], capture_output=True).returncode == 0
    except OSError:
        return False


class Session:
    """What all runs share, and the commands of one run."""

    def __init__(self, args):
        self.args, self.work, self.data = args, args.work.resolve(), args.data.resolve()
        self.pythons, self.left_out = {}, []
        self.machine = machine(args.gpu, args.machine)
        self.commit = args.commit or commit_of(scenes.REPOSITORY)
        if not self.commit:
            sys.exit('run.py: no git here: --commit says which program is measured')
        self.hashes = {}
        self.begin()

    def begin(self):
        self.commands, self.cpu, self.wall, self.load = [], 0.0, 0.0, os.getloadavg()[0]

    def call(self, *command, timed=True, log=None):
        """Runs a command; its times count when `timed`. Raises Failed."""
        command = [str(word) for word in command]
        if timed:
            self.commands.append(' '.join(self.shown(word) for word in command))
        before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
        with open(log or os.devnull, 'a') as out:
            code = subprocess.run(command, stdout=out, stderr=subprocess.STDOUT).returncode
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        if timed:
            self.wall += time.monotonic() - started
            self.cpu += after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        if code != 0:
            raise Failed(code)

    def shown(self, word):
        """Without the paths of this machine."""
        for path, name in ((str(self.args.program), 's2gs'), (str(self.work), 'WORK'), (str(self.data), 'DATA'),
                           (f'{self.args.tools}/', ''), (str(scenes.REPOSITORY), '.'), (str(scenes.REPOSITORY.parent), '..')):
            word = word.replace(path, name)
        return re.sub(r'^/.*/(?=shared/data)', '../', word)

    def gpu(self):
        return ['--use_gpu', '1' if self.args.gpu else '0']

    def python(self, modules):
        """A Python that imports these ("numpy, cv2"); raises FileNotFoundError where there is none and none can be made."""
        if modules not in self.pythons:
            known = [self.args.python] if self.args.python else [sys.executable, '/usr/bin/python3', str(VENV / 'bin/python')]
            self.pythons[modules] = next((p for p in known if has_modules(p, modules)), None)
            if self.pythons[modules] is None and not self.args.python:
                self.pythons[modules] = self.made_python(modules)
        if self.pythons[modules] is None:
            raise FileNotFoundError(f'no Python with {modules}: --python names one (pip install -r {HERE}/requirements.txt)')
        return self.pythons[modules]

    def made_python(self, modules):
        """That of the venv, which is made; None where it cannot be."""
        print(f'making a venv with what requirements.txt names: {VENV}', flush=True)
        python = str(VENV / 'bin/python')
        base = next((p for p in ('/usr/bin/python3', sys.executable) if os.path.exists(p)), sys.executable)
        try:
            subprocess.run([base, '-m', 'venv', VENV], check=True)
            subprocess.run([python, '-m', 'pip', 'install', '--quiet', '--disable-pip-version-check', '-r',
                            HERE / 'requirements.txt'], check=True)
        except (OSError, subprocess.CalledProcessError) as error:
            print(f'which failed: {error}', flush=True)
        return python if has_modules(python, modules) else None

    def folder(self, suite, scene, seed, variant=''):
        return self.work / f'{suite}-{scene}{"-" + variant if variant else ""}-{seed}'


# --- Figures ------------------------------------------------------------------------------------------------

def evaluator_figures(path):
    """Of scan_evaluator's JSON: {"object_rot_deg.median": number}."""
    read = json.loads(path.read_text())['figures']
    return {f'{name}.{statistic}': value for name, values in read.items() for statistic, value in values.items()
            if isinstance(value, (int, float)) and not isinstance(value, bool)}


def score(session, workspace, scene):
    """Against the truth where there is one; the real sets' markers by the shared scorer."""
    path = workspace / 'figures.json'
    if (scene / 'gt/scene.json').exists():
        session.call(session.args.program, 'scan_evaluator', '--workspace_path', workspace, '--ground_truth_path', scene,
                     '--json_path', path, timed=False)
        return evaluator_figures(path)
    scorer = scene.parent.parent / 'tools/score_real.py'
    if (scene / 'reference.json').exists() and scorer.exists():
        done = subprocess.run([session.python('numpy, cv2'), scorer, workspace, scene, '--json'], capture_output=True, text=True)
        if done.returncode != 0:
            raise Failed(done.returncode)
        out = {}
        for name, value in json.loads(done.stdout).items():
            parts = dict(zip(('median', 'max'), value)) if isinstance(value, list) else {'value': value}
            if name == 'registered':
                parts = dict(zip(('value', 'of'), value))
            out.update({f'{name}.{k}': v for k, v in parts.items() if isinstance(v, (int, float))})
        return out
    return {}


def training_figures(log):
    """Of log.jsonl: the last measurement on photos never seen."""
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    held_out = [line for line in lines if line.get('event') == 'held_out']
    if not held_out:
        return {}
    last = held_out[-1]
    out = {name: last[name] for name in ('iteration', 'count', 'psnr_db', 'ssim', 'object_psnr_db', 'object_ssim', 'mask_iou')
           if isinstance(last.get(name), (int, float))}
    # Not a number, and so no figure: measure_one moves it beside them.
    curve = [[round(line['wall_s'], 2), round(line['object_psnr_db'], 3)] for line in held_out
             if line['wall_s'] > 0 and isinstance(line.get('object_psnr_db'), (int, float))]
    return {**out, 'train_wall_seconds': round(last['wall_s'], 2), 'train_cpu_seconds': round(last['cpu_s'], 1),
            'curve': curve}


def scan_figures(report):
    """Of report.json: whether the poses are called good, seconds of each stage."""
    read = json.loads(report.read_text())
    verdict = {'called_good': int(read['verdict']['verdict'] == 'good')} if 'verdict' in read else {}
    return {**verdict, **{f'stage_seconds.{s["name"]}': round(s['seconds'], 1) for s in read.get('stages', []) if s.get('run')}}


# --- Suites: each yields (variant, function that measures and returns figures) -------------------------------

def scan(session, suite, name, scene, seed, until):
    workspace = session.folder(suite, name, seed)
    shutil.rmtree(workspace, ignore_errors=True)
    workspace.mkdir(parents=True)
    session.call(session.args.program, 'automatic_scanner', '--workspace_path', workspace, '--image_path', scene / 'images',
                 '--until', until, '--random_seed', seed, *session.gpu(), log=workspace / 'log.txt')
    figures = score(session, workspace, scene)
    return {**figures, **scan_figures(workspace / 'report.json')}


def poses(session, name, scene, seed):
    yield '', lambda: scan(session, 'poses', name, scene, seed, 'split')
    version = re.search(r'COLMAP (\S+)', first_line(['colmap', '-h']))
    if name in BESIDE_COLMAP and version and seed == 0:  # COLMAP has no seed of ours
        yield f'COLMAP {version[1]}, perfect masks', lambda: colmap_alone(session, name, scene)


def colmap_alone(session, name, scene):
    """Poses of what turns by COLMAP itself, which sees it alone: all pairs, one camera, the model of most photos."""
    exact = exact_workspace(session, name, scene, 'masks')
    workspace = session.folder('poses', name, 0, 'colmap')
    shutil.rmtree(workspace, ignore_errors=True)
    (workspace / 'models').mkdir(parents=True)
    database, log = workspace / 'database.db', workspace / 'log.txt'
    os.environ.setdefault('QT_QPA_PLATFORM', 'offscreen')
    session.call('colmap', 'feature_extractor', '--database_path', database, '--image_path', exact / 'images', '--ImageReader.mask_path',
                 exact / 'masks', '--ImageReader.single_camera', 1, '--SiftExtraction.use_gpu', 0, log=log)
    session.call('colmap', 'exhaustive_matcher', '--database_path', database, '--SiftMatching.use_gpu', 0, log=log)
    session.call('colmap', 'mapper', '--database_path', database, '--image_path', exact / 'images', '--output_path',
                 workspace / 'models', log=log)
    models = list((workspace / 'models').iterdir())
    if not models:
        raise Failed(1)
    (workspace / 'sparse').mkdir()
    shutil.copytree(max(models, key=lambda model: (model / 'images.bin').stat().st_size), workspace / 'sparse/0')
    return {name: value for name, value in score(session, workspace, scene).items() if value is not None}


def whole_scan(session, name, scene, seed):
    yield '', lambda: scan(session, 'scan', name, scene, seed, 'mesh')


def start_points(session, name, scene):
    """The models that training starts from, as options of exact_workspace.py; none where nothing ran that makes them."""
    found = [scene / 'points', *(session.folder(suite, name, 0) / 'sparse' for suite in ('poses', 'scan'))]
    models = next(([folder / kind for kind in kinds] for folder, kinds in zip(found, [('object', 'static'), *[('0', 'static')] * 2])
                   if (folder / kinds[0]).exists()), [])
    return [w for option, model in zip(('--object_model', '--static_model'), models) if model.exists() for w in (option, model)]


def exact_workspace(session, name, scene, mode):
    workspace = session.folder('exact', name, 0, mode)
    if not (workspace / 'turntable.json').exists():
        points = start_points(session, name, scene)
        session.call(session.python('numpy'), scenes.HERE / 'exact_workspace.py', scene, workspace, *points,
                     *(['--masks'] if mode == 'masks' else []), timed=False)
    return workspace


def held_out(workspace):
    """Which photos training does not see: the scene's own, or every tenth where it has none."""
    listed = workspace / 'test_list.txt'
    return ['--test_list', listed] if listed.exists() and listed.read_text().split() else ['--test_every', '10']


def train_model(session, name, scene, seed, mode):
    """Trains, unless the model is there; returns its workspace."""
    workspace, model = exact_workspace(session, name, scene, mode), session.folder('train', name, seed, mode)
    if (model / 'point_cloud.ply').exists():
        return workspace, model
    course = [] if session.args.gpu else CPU_COURSE
    session.call(session.args.program, 'gaussian_trainer', '--workspace_path', workspace, '--output_path', model, '--mode', mode,
                 *held_out(workspace), '--truth_mask_path', workspace / 'truth_masks', '--random_seed',
                 seed, *course, *session.gpu(), log=workspace / f'train-{seed}.txt')
    return workspace, model


def train(session, name, scene, seed):
    def measure(mode):
        for kind, its_seed in (('exact', 0), ('train', seed)):
            shutil.rmtree(session.folder(kind, name, its_seed, mode), ignore_errors=True)
        workspace, model = train_model(session, name, scene, seed, mode)
        points = sum(len((workspace / 'sparse' / kind / 'points3D.txt').read_text().splitlines()) for kind in ('0', 'static'))
        return {**training_figures(model / 'log.jsonl'), 'start_points': points}
    for mode in ('s2gs', 'masks'):
        yield mode, lambda mode=mode: measure(mode)


def mesh(session, name, scene, seed):
    def measure(mode):
        exact, model = train_model(session, name, scene, seed, mode)
        session.begin()
        workspace = session.folder('mesh', name, seed, mode)
        shutil.rmtree(workspace, ignore_errors=True)
        shutil.copytree(exact, workspace, symlinks=True, ignore=shutil.ignore_patterns('s2gs', 'masks', 'dense', '*.txt'))
        shutil.copytree(exact / 'sparse', workspace / 'sparse', dirs_exist_ok=True)
        (workspace / 's2gs').mkdir(exist_ok=True)
        shutil.copy(model / 'point_cloud.ply', workspace / 's2gs/point_cloud.ply')
        for command in ('gaussian_renderer', 'tsdf_mesher'):
            session.call(session.args.program, command, '--workspace_path', workspace, *session.gpu(),
                         *(['--Cleanup.remove_disc', '1'] if command == 'tsdf_mesher' else []), log=workspace / 'log.txt')
        return score(session, workspace, scene)
    for mode in ('s2gs', 'masks'):
        yield mode, lambda mode=mode: measure(mode)


def numbers_of(pattern, text, names):
    """{name: number} of each group of a pattern that must match."""
    match = re.search(pattern, text)
    if match is None:
        raise ValueError(f'this output has not the expected form: {text[-300:]}')
    return {name: float(value) for name, value in zip(names, match.groups())}


def kernels(session, name, scene, seed):
    def bench(program, *arguments):
        log = session.work / f'{program}.txt'
        log.unlink(missing_ok=True)
        session.call(session.args.tools / program, *arguments, log=log)
        return log.read_text()

    def fusion():
        text = bench('tsdf_bench', 100, 640, session.machine['cores'], *(['cuda'] if session.args.gpu else []))
        return numbers_of(r': ([\d.]+) s \(median of 3, CPU ([\d.]+);.*peak (\d+) MiB.*error mean (-?[\d.]+) rms ([\d.]+)', text,
                          ['fusion_seconds', 'fusion_cpu_seconds', 'peak_mib', 'mean_error_voxels', 'rms_error_voxels'])

    def step():
        workspace, model = train_model(session, name, scene, seed, 's2gs')
        session.begin()
        ply = model / 'point_cloud.ply'
        if session.args.gpu:
            text = bench('gpu_step_bench', workspace, ply, 640, 0, 45, 3)
            return numbers_of(r'\| (\d+) \| \d+ x \d+ \| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \| (\d+) \|', text,
                              ['count', 'step_learning_ms', 'step_frozen_ms', 'step_plain_ms', 'peak_mib'])
        text = bench('step_bench', workspace, ply, 200, 20000, 20)
        return {**numbers_of(r'1 thread\(s\), without normals: ([\d.]+) ms', text, ['step_1_thread_ms']),
                **numbers_of(r'1 thread\(s\), with normals: ([\d.]+) ms', text, ['step_1_thread_normals_ms'])}
    yield 'fusion of a sphere', fusion
    yield 'step', step


RUNNERS = {'poses': poses, 'scan': whole_scan, 'train': train, 'mesh': mesh, 'kernels': kernels}


# --- Safety: not of a scene, and written by the programs that measure it --------------------------------------

def fuzz_targets(session):
    """The folder of the built targets; None where clang is not there or they do not compile."""
    build = scenes.REPOSITORY / 'build/fuzz'
    if not shutil.which('clang++'):
        return None
    steps = (['cmake', '--preset', 'fuzz'], ['cmake', '--build', '--preset', 'fuzz', '-j', str(session.machine['cores'])])
    for step in steps:
        with open(session.work / 'fuzz_build.txt', 'a') as log:
            if subprocess.run(step, cwd=scenes.REPOSITORY, stdout=log, stderr=subprocess.STDOUT).returncode != 0:
                return None
    return build


def run_safety(session, parts):
    """The number of parts that found a fault. Their results are those of the programs' --record."""
    tests, example = scenes.REPOSITORY / 'tests', scenes.REPOSITORY / 'examples/falcon_desk/images'
    failures = 0
    for part in parts:
        print(f'{time.strftime("%H:%M:%S")} safety: {part}', flush=True)
        began = time.monotonic()
        if part == 'hostile':
            command = [tests / 'hostile/run.py', session.args.program, '--full']
        elif part == 'kills':
            command = [tests / 'bench/scan_kill_test.py', session.args.program, example, session.work / 'kills', '--kills', KILLS,
                       '--keep', 's1_a', '--iterations', 60, '--size', 48, '--share_features', '--variant', '20 photos of 400 px']
        elif build := fuzz_targets(session):
            command = [tests / 'fuzz/run.py', build, '--seconds', FUZZ_SECONDS]
        else:
            session.left_out.append(f'safety fuzz: clang++ is not there or the targets do not compile ({session.work}/fuzz_build.txt)')
            continue
        python = session.python('numpy, cv2') if part == 'hostile' else sys.executable
        code = subprocess.run([str(word) for word in (python, *command, '--record')], stdout=open(session.work / f'{part}.txt', 'w'),
                              stderr=subprocess.STDOUT).returncode
        failures += code != 0
        print(f'  {"FAILED: " if code else ""}{session.work}/{part}.txt, {time.monotonic() - began:.0f} s', flush=True)
    return failures


# --- Bookkeeping --------------------------------------------------------------------------------------------

def is_done(folder, stub):
    """Whether the result of this run is there, from the same commit and data."""
    path = pathlib.Path(folder) / results.file_name(stub)
    if not path.exists():
        return False
    there = results.parse(path.read_text(), path)
    return there['exit_code'] == 0 and all(there[key] == stub[key] for key in ('commit', 'data_hash'))


def measure_one(session, stub, measure):
    """Runs, and writes the result also when it fails: then with the exit code and no figures."""
    session.begin()
    code, figures = 0, {}
    try:
        figures = measure()
    except Failed as failure:
        code = failure.code
    curve = {'curve': figures.pop('curve')} if figures.get('curve') else {}
    figures = {**figures, 'cpu_seconds': round(session.cpu, 1), 'wall_seconds': round(session.wall, 1),
               'load': round(session.load, 1)}
    result = {**stub, 'command': session.commands, 'recorded': 'by run.py', 'exit_code': code, 'figures': figures, **curve}
    return results.write_result(session.args.results, result), code


def run_suite(session, suite, names, seeds):
    """The number of runs that failed. What is not there is added to session.left_out."""
    all_scenes, failures = scenes.read_scenes(), 0
    for at, name in enumerate(names, 1):
        try:
            scene = scenes.find_scene(name, all_scenes[name], session.data, lambda: session.python('open3d, scipy, PIL'))
            if suite == 'poses' and (scene / 'reference.json').exists():
                session.python('numpy, cv2')  # which scores it
        except FileNotFoundError as error:
            session.left_out.append(f'{suite} {error}')
            print(f'LEFT OUT {session.left_out[-1]}', flush=True)
            continue
        if name not in session.hashes:
            session.hashes[name] = scenes.folder_hash(scene)
            if note := scenes.check_hash(name, all_scenes[name], session.hashes[name]):
                print(note, flush=True)
        for seed in seeds:
            for variant, measure in RUNNERS[suite](session, name, scene, seed):
                if session.args.variants not in variant:
                    continue
                stub = {'suite': suite, 'scene': name, 'variant': variant, 'seed': seed, 'commit': session.commit,
                        'machine': session.machine, 'data_hash': session.hashes[name]}
                if not session.args.again and is_done(session.args.results, stub):
                    print(f'done already: {results.file_name(stub)}', flush=True)
                    continue
                print(f'{time.strftime("%H:%M:%S")} {suite}, scene {at} of {len(names)}: {name}'
                      f'{", " + variant if variant else ""}, seed {seed}', flush=True)
                began = time.monotonic()
                path, code = measure_one(session, stub, measure)
                failures += code != 0
                print(f'  {"FAILED, exit code " + str(code) + ": " if code else ""}{path}, {time.monotonic() - began:.0f} s', flush=True)
    return failures


def check_programs(args, suites):
    """Sets the programs that were not named; ends with what is missing and what makes it."""
    if not args.program:
        args.program = next((b / 's2gs' for b in BUILDS if (b / 's2gs').exists()), BUILDS[-1] / 's2gs')
    args.program = args.program.resolve()
    if not args.program.exists():
        sys.exit(f'run.py: no program {args.program}: `bash tests/run.sh` builds build/tests/s2gs, and --program names another')
    args.tools = args.tools or args.program.parent / 'tests'
    needed = ['tsdf_bench', 'gpu_step_bench' if args.gpu else 'step_bench'] if 'kernels' in suites else []
    if missing := [name for name in needed if not (args.tools / name).exists()]:
        sys.exit(f'run.py: no {" and no ".join(missing)} in {args.tools}: build them, name their folder with --tools, '
                 'or name suites without kernels')


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('suites', nargs='*', metavar='SUITE')
    parser.add_argument('--scenes', nargs='+', choices=sorted(scenes.read_scenes()))
    parser.add_argument('--variants', default='', metavar='WORD', help='of a scene, only those whose name has this')
    parser.add_argument('--seeds', nargs='+', type=int, default=[0])
    parser.add_argument('--gpu', action='store_true')
    parser.add_argument('--program', type=pathlib.Path)
    parser.add_argument('--tools', type=pathlib.Path, help="default: tests, in the program's folder")
    parser.add_argument('--python', help='one that has what requirements.txt names')
    parser.add_argument('--data', type=pathlib.Path, default=scenes.REPOSITORY / 'build/bench/data')
    parser.add_argument('--work', type=pathlib.Path, default=scenes.REPOSITORY / 'build/bench/work')
    parser.add_argument('--results', type=pathlib.Path, default=results.RESULTS)
    parser.add_argument('--again', action='store_true', help='also what is done')
    parser.add_argument('--commit', help='of the program, where there is no git')
    parser.add_argument('--machine', help="the machine's name in the results")
    parser.add_argument('--no_report', action='store_true', help='leave BENCHMARK.md and README.md as they are')
    args = parser.parse_args()
    known = [*SUITES, 'safety']
    if unknown := [name for name in args.suites if name not in known]:
        parser.error(f'no suite {unknown[0]}: {", ".join(known)}')
    suites = args.suites or [name for name in known if not args.gpu or name in ON_BARE_NODE]
    check_programs(args, suites)
    session = Session(args)
    session.work.mkdir(parents=True, exist_ok=True)
    session.data.mkdir(parents=True, exist_ok=True)
    failures, took = 0, []
    for suite in suites:
        began = time.monotonic()
        if suite == 'safety':
            failures += run_safety(session, SAFETY)
        else:
            failures += run_suite(session, suite, args.scenes or SUITES[suite][bool(args.gpu)], args.seeds)
        took.append(f'{suite} {time.monotonic() - began:.0f} s')
    print('; '.join(took), *(f'left out: {one}' for one in session.left_out), sep='\n', flush=True)
    if not args.no_report and args.results.resolve() == results.RESULTS:
        report.main([])
        print('written: BENCHMARK.md, its plots, the figures of README.md')
    return 1 if failures else 0


if __name__ == '__main__':
    sys.exit(main())
