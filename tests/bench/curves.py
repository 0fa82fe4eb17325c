#!/usr/bin/env python3
"""Error against run time of many knobs, scenes and seeds at once on one machine, most valuable first.

usage: curves.py PLAN S2GS DATA OUTPUT [--seconds N] [--cores N] [--gpus N] [--gpu_jobs N] [--only NAME ...] [--commit HASH]
       curves.py PLAN S2GS DATA OUTPUT --collect FOLDER --commit HASH --machine TEXT

PLAN is a JSON list in order of worth (curves.json), S2GS the program (that of preset `trainer` will do), DATA holds a
scan for each scene. Every call of `s2gs work_precision` is a job of its own, one scene and one seed, on cores of its
own, and every entry of PLAN has scans of its own (OUTPUT/scans); at the deadline what still runs is ended. Calls that
are done are not made again; one of which no run came to a result has failed. OUTPUT/jobs.log has a line a job: began,
ended, exit code, state, name. --collect puts the calls of each entry together into FOLDER/NAME.json and .csv, of sweeps
.html too (tests/bench/results/curves for BENCHMARK.md), with the command, the commit and the machine; a call that was cut
off counts with the runs that it finished.

An entry of PLAN has `name` and one of
  `knob`     a sweep: `values` are lists of lists, a call each;
  `forced`   parts of training that the plan leaves out, run all the same: a call for each scene and seed;
  `command`  anything else, with {programs} (S2GS's folder), {data}, {output}, {here} and {commit} filled in;
and may have `scenes`, `seeds`, `arguments` (as --arguments), `gpu` (true: at most --gpu_jobs at a time on each of --gpus),
`cores` of a call, `jobs` (runs of a sweep's call at a time; of forced parts as many as cores), `needs` (seconds: a call
is not begun when fewer are left), `truth` (measured against DATA/SCENE/gt), `about` (what stands beside the command), and
`model`: each scene and seed is first trained with these arguments and rendered, and the sweep begins from there.
"""
import argparse
import json
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import tempfile
import time

HERE = pathlib.Path(__file__).resolve().parent


class Job:
    def __init__(self, name, commands, gpu=False, cores=1, after=None, needs=0):
        self.name, self.commands, self.gpu, self.cores, self.after, self.needs = name, commands, gpu, cores, after, needs
        self.written = None  # the file of a call of work_precision
        self.state = 'waiting'  # running, done, failed, cut off
        self.process, self.own_cores, self.own_gpu, self.started, self.seconds = None, [], None, 0.0, 0.0


def model_folder(output, scene, seed):
    return output / 'models' / f'seed{seed}' / scene


def scan_folder(entry, output, scene):
    """Runs of two entries may have one name, so that each has a scan of its own."""
    return output / 'scans' / entry['name'] / scene


def make_scans(plan, data, output):
    for entry in plan:
        for scene in entry.get('scenes', []) if 'model' not in entry else []:
            folder = scan_folder(entry, output, scene)
            if not folder.exists():
                shutil.copytree(data / scene, folder.with_suffix('.part'), ignore=shutil.ignore_patterns('work_precision'))
                folder.with_suffix('.part').rename(folder)


def call_name(entry, scene, seed, i=0):
    return f'{entry["name"]}.{scene}.seed{seed}' + (f'.{i}' if 'knob' in entry else '')


def arguments_of(entry, folder):
    """Masks of the truth are there to measure by, where a scene has them."""
    words = list(entry.get('arguments', []))
    if words and (folder / 'truth_masks').is_dir() and 'model' not in entry:
        words.append(('gaussian_trainer.' if 'forced' in entry else '') + 'truth_mask_path={workspace}/truth_masks')
    return ['--arguments', ','.join(words)] if words else []


def jobs_of(plan, s2gs, data, output, commit=None):
    """In the order of PLAN; of sweeps that begin from models, the models stand before their first sweep."""
    jobs, models = [], {}
    for entry in plan:
        gpu, cores, needs = entry.get('gpu', False), entry.get('cores', 1), entry.get('needs', 0)
        use_gpu = ['--use_gpu', '1' if gpu else '0']
        if 'command' in entry:
            words = [w.format(programs=pathlib.Path(s2gs).parent, data=data, output=output, here=HERE, commit=commit)
                     for w in entry['command']]
            jobs.append(Job(entry['name'], [words], gpu, cores, needs=needs))
            continue
        # A seed of all scenes before the next, so that the end of the time costs all scenes alike.
        for seed, scene in [(seed, scene) for seed in entry['seeds'] for scene in entry['scenes']]:
            truth = ['--ground_truth_path', str(data / scene)] if entry.get('truth') else []
            arguments = arguments_of(entry, data / scene)
            folder, after = scan_folder(entry, output, scene), None
            if 'forced' in entry:
                name = call_name(entry, scene, seed)
                jobs.append(Job(name, [[s2gs, 'work_precision', '--workspace_path', str(folder),
                                        '--forced', ','.join(entry['forced']), '--seeds', str(seed), '--jobs', str(cores),
                                        *use_gpu, *truth, *arguments, '--output_path', str(output / 'calls' / name)]],
                                gpu, cores, needs=needs))
                continue
            if 'model' in entry:
                folder = model_folder(output, scene, seed)
                if (scene, seed) not in models:
                    on = [str(folder), '--use_gpu', '1' if entry['model'].get('gpu') else '0', '--random_seed', str(seed)]
                    options = [w for a in entry['model']['arguments'] for w in ('--' + a.split('=')[0], a.split('=', 1)[1])]
                    models[scene, seed] = Job(
                        f'model.{scene}.seed{seed}',
                        [['cp', '-r', str(data / scene) + '/.', str(folder)],
                         ['rm', '-rf', str(folder / 'work_precision')],  # sweeps of the scan itself
                         [s2gs, 'gaussian_trainer', '--workspace_path', *on, *options],
                         [s2gs, 'gaussian_renderer', '--workspace_path', *on]], entry['model'].get('gpu', False))
                    jobs.append(models[scene, seed])
                after = models[scene, seed]
            for i, values in enumerate(entry['values']):
                name = call_name(entry, scene, seed, i)
                jobs.append(Job(name, [[s2gs, 'work_precision', '--workspace_path', str(folder), '--knob', entry['knob'],
                                        '--values', ','.join(values), '--seeds', str(seed), '--jobs', str(entry.get('jobs', 1)),
                                        *use_gpu, *truth, *arguments, '--output_path', str(output / 'calls' / name)]],
                                gpu, cores, after, needs))
    for job in jobs:
        if 'work_precision' in job.commands[-1]:
            job.written = output / 'calls' / f'{job.name}.json'
    return jobs


def has_result(path):
    """Whether a run of a call came to a result: the call itself ends well where none did."""
    written = json.loads(path.read_text())
    return any(not point['failure'] for curve in written.get('curves', [written]) for point in curve['points'])


def run_jobs(jobs, output, seconds, cores, gpu_jobs, gpus=1, tick=0.2):
    """Until all are done or the time is up; a job's state says what became of it."""
    beginning = time.monotonic()
    deadline = beginning + seconds
    free = list(cores)
    for folder in ('calls', 'logs', 'done', 'models'):
        (output / folder).mkdir(parents=True, exist_ok=True)
    for job in jobs:
        if (output / 'done' / job.name).exists():
            job.state = 'done'

    def gpu_of_fewest():
        """The GPU on which fewest jobs run, and how many those are."""
        running = [sum(j.state == 'running' and j.own_gpu == gpu for j in jobs) for gpu in range(gpus)]
        return running.index(min(running)), min(running)

    def start(job):
        job.own_gpu = gpu_of_fewest()[0] if job.gpu else None
        job.own_cores = [free.pop() for _ in range(job.cores)]
        job.started = time.monotonic()
        job.state = 'running'
        if job.name.startswith('model.'):
            folder = pathlib.Path(job.commands[0][-1])
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
        script = ' && '.join(' '.join(map(quoted, words)) for words in job.commands)
        own = set(job.own_cores)
        seen = dict(os.environ, CUDA_VISIBLE_DEVICES=str(job.own_gpu)) if gpus > 1 and job.gpu else None
        with open(output / 'logs' / f'{job.name}.log', 'w') as log:
            job.process = subprocess.Popen(['sh', '-c', script], stdout=log, stderr=log, start_new_session=True, env=seen,
                                           preexec_fn=lambda: os.sched_setaffinity(0, own))

    def finish(job, state):
        job.state, job.seconds = state, time.monotonic() - job.started
        free.extend(job.own_cores)
        if state == 'done':
            (output / 'done' / job.name).write_text(f'{job.seconds:.1f}\n')
        print(f'{state:8} {job.seconds:7.1f} s  {job.name}', flush=True)
        began = job.started - beginning
        with open(output / 'jobs.log', 'a') as log:
            log.write(f'{began:.1f}\t{began + job.seconds:.1f}\t{job.process.returncode}\t{state}\t{job.name}\n')

    def may_start(job):
        if job.after is not None and job.after.state != 'done' or deadline - time.monotonic() < job.needs:
            return False
        if job.gpu:
            return job.cores <= len(free) and gpu_of_fewest()[1] < gpu_jobs
        # Cores are kept for worthier jobs of the GPU, which would stand idle otherwise.
        ready = [j for j in jobs[:jobs.index(job)]
                 if j.state == 'waiting' and j.gpu and (j.after is None or j.after.state == 'done')]
        kept = min(len(ready), gpus * gpu_jobs - sum(j.state == 'running' and j.gpu for j in jobs))
        return job.cores <= len(free) - kept

    while time.monotonic() < deadline:
        for job in jobs:
            if job.state == 'running' and job.process.poll() is not None:
                is_done = job.process.returncode == 0 and (job.written is None or has_result(job.written))
                finish(job, 'done' if is_done else 'failed')
        for job in jobs:
            if job.after is not None and job.after.state == 'failed' and job.state == 'waiting':
                job.state = 'failed'
            if job.state == 'waiting' and may_start(job):
                start(job)
        if not any(job.state == 'running' for job in jobs):
            break
        time.sleep(tick)
    for job in jobs:
        if job.state == 'running':
            os.killpg(job.process.pid, signal.SIGKILL)
            job.process.wait()
            finish(job, 'cut off')


def with_scenes_of(plan, data):
    """Without the scenes that DATA lacks, which are named."""
    missing = {scene for entry in plan for scene in entry.get('scenes', []) if not (data / scene).is_dir()}
    if missing:
        print(f'{data} lacks {", ".join(sorted(missing))}: left out', file=sys.stderr)
    kept = [{**entry, 'scenes': [s for s in entry['scenes'] if s not in missing]} if 'scenes' in entry else entry for entry in plan]
    return [entry for entry in kept if 'command' in entry or entry['scenes']]


def quoted(word):
    return "'" + str(word).replace("'", "'\\''") + "'"


def command_text(entry):
    """As it stands beside a curve: what was called, without the folders."""
    words = ['work_precision']
    words += ['--knob', entry['knob']] if 'knob' in entry else ['--forced', ','.join(entry['forced'])]
    words += ['--use_gpu', '1' if entry.get('gpu') else '0', '--seeds', ','.join(map(str, entry['seeds']))]
    if entry.get('arguments'):
        words += ['--arguments', ','.join(entry['arguments'])]
    model = entry.get('model')
    text = ' '.join(words) + (f', on models trained with {",".join(model["arguments"])}' if model else '')
    return '; '.join([text, *([entry['about']] if 'about' in entry else [])])


def finished_runs(entry, knob, folder, scene, seed, values, pattern):
    """The curve of a call that was cut off: `pattern`, a call of the same sweep that was not, with the runs that had
    ended, as their workspaces in FOLDER have them. None where there is none."""
    points = []
    for value in values:
        path = folder / 'work_precision' / knob / f'{value}_seed{seed}' / 'point.json'
        if not path.exists():
            continue
        point = json.loads(path.read_text())
        command, *settings = point.pop('settings').split(' ')
        arguments = {word.removeprefix(f'{command}.') for word in entry.get('arguments', [])
                     if 'forced' not in entry or word.startswith(f'{command}.')}
        # Another sweep of the knob may have been there; an error against the longest run is known when all have ended.
        if arguments <= set(settings) and (point['failure'] or pattern['error'] in point['figures']):
            points.append({**point, 'scene': 0})
    return {**pattern, 'scenes': [scene], 'values': [point['value'] for point in points], 'points': points} if points else None


def finished_forced_runs(entry, folder, scene, seed, pattern):
    """The same of a call of forced parts, which has a curve for each stage that has a part."""
    found = [finished_runs(entry, curve['knob'], folder, scene, seed, curve['values'], curve) for curve in pattern['curves']]
    return {**pattern, 'parts': [], 'curves': [curve for curve in found if curve]} if any(found) else None


def calls_of(entry, output, cut_off):
    """Files of an entry's calls that ended; of others that have runs which did, files in the folder `cut_off`."""
    calls = {call_name(entry, scene, seed, i): (scene, seed, values) for scene in entry['scenes']
             for seed in entry['seeds'] for i, values in enumerate(entry.get('values', [None]))}
    files = {name: output / 'calls' / f'{name}.json' for name in calls}
    ended = [path for path in files.values() if path.exists()]
    if not ended:
        return ended
    pattern = json.loads(ended[0].read_text())
    for name, (scene, seed, values) in calls.items():
        if files[name].exists():
            continue
        folder = model_folder(output, scene, seed) if 'model' in entry else scan_folder(entry, output, scene)
        found = (finished_forced_runs(entry, folder, scene, seed, pattern) if 'forced' in entry
                 else finished_runs(entry, entry['knob'], folder, scene, seed, values, pattern))
        if found:
            path = pathlib.Path(cut_off, f'{name}.json')
            path.write_text(json.dumps(found))
            ended.append(path)
    return ended


def collect(plan, s2gs, output, folder, commit, machine):
    """FOLDER/NAME.* of every sweep and forced part of which a call is there; returns the names."""
    folder.mkdir(parents=True, exist_ok=True)
    made = []
    for entry in plan:
        if 'command' in entry:
            continue
        path = folder / f'{entry["name"]}.json'
        with tempfile.TemporaryDirectory() as cut_off:
            calls = calls_of(entry, output, cut_off)
            if not calls:
                continue
            forced = ['--forced', '1'] if 'forced' in entry else []
            subprocess.run([s2gs, 'work_precision', *forced, '--curves', ','.join(map(str, calls)), '--output_path',
                            str(path.with_suffix('')), '--log_level', 'warning'], check=True, stdout=subprocess.DEVNULL)
        content = json.loads(path.read_text())
        short = (any(setting['runs'] < len(entry['seeds']) for setting in content.get('settings', []))
                 or any(part['seeds'] < len(entry['seeds']) for part in content.get('parts', [])))
        command = command_text(entry)
        if short:
            command += '; what has fewer runs was cut off'
        content['made'] = {'command': command, 'commit': commit, 'machine': machine}
        path.write_text(json.dumps(content, indent=1, ensure_ascii=False) + '\n')
        made.append(entry['name'])
    return made


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('plan', type=pathlib.Path)
    parser.add_argument('s2gs')
    parser.add_argument('data', type=pathlib.Path)
    parser.add_argument('output', type=pathlib.Path)
    parser.add_argument('--seconds', type=float, default=1e9)
    parser.add_argument('--cores', type=int)
    parser.add_argument('--gpus', type=int, default=1)
    parser.add_argument('--gpu_jobs', type=int, default=4)
    parser.add_argument('--only', nargs='+', default=[])
    parser.add_argument('--collect', type=pathlib.Path)
    parser.add_argument('--commit')
    parser.add_argument('--machine')
    args = parser.parse_args(arguments)
    plan = [entry for entry in json.loads(args.plan.read_text()) if not args.only or entry['name'] in args.only]
    args.data, args.output = args.data.resolve(), args.output.resolve()
    plan = with_scenes_of(plan, args.data)
    if args.collect:
        if not args.commit or not args.machine:
            parser.error('--collect needs --commit and --machine')
        print('\n'.join(collect(plan, args.s2gs, args.output, args.collect, args.commit, args.machine)))
        return 0
    cores = sorted(os.sched_getaffinity(0))[:args.cores]
    make_scans(plan, args.data, args.output)
    jobs = jobs_of(plan, args.s2gs, args.data, args.output, args.commit)
    run_jobs(jobs, args.output, args.seconds, cores, args.gpu_jobs, args.gpus)
    for state in ('done', 'failed', 'cut off', 'waiting'):
        print(f'{state}: {sum(job.state == state for job in jobs)}')
    return 0 if all(job.state == 'done' for job in jobs) else 1


if __name__ == '__main__':
    sys.exit(main())
