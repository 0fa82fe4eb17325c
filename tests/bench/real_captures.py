#!/usr/bin/env python3
"""Scans as real captures are: renders them, runs s2gs on their photos up to the poses, and says what came out.

usage: real_captures.py render FOLDER [--list FILE] [--only NAME...] [--python PYTHON] [--jobs N]
       real_captures.py run FOLDER WORKSPACES --s2gs S2GS [--colmap_path COLMAP] [--list FILE] [--only NAME...]
                        [--jobs N] [--options="WORD ..."]
       real_captures.py score FOLDER WORKSPACES [--list FILE] [--only NAME...] [--json FILE]
       real_captures.py draw COUNT --seed SEED > LIST

FOLDER holds a folder for each scan of LIST (real_captures.txt beside this file), as render_scene.py leaves it; other
scans of render_scene.py in it count too when --only names them. A scan that is there is not rendered again. `draw` makes
lists of scans that nobody has seen: everything that a capture may have is drawn at random, from the seed. `run` stops at
the poses, on the CPU; --options are others of automatic_scanner in place of that.

The table: photos placed of all; the errors of cam_from_object's rotation after the best common rotation of all photos, and
of the table's angle after that of all photos between which the scan says that it knows it ("sets" where it says that it
does not between all: an angle between sets is a choice), median / largest [degrees]; what the program says of the scan;
and whether that is right: a scan is right when all photos are placed, at 0.3 degrees in the median and 1 degree at most,
and `good` may be said of such alone. Where the plate wobbles the angle is that of the whole tilted pose. Needs numpy and
scipy.
"""
import argparse, json, os, subprocess, sys, time
from concurrent.futures import ThreadPoolExecutor
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

COMMON = '--width 480 --height 360 --samples 2 --held_out 0 --things 24'.split()
MEDIAN_DEG, MAX_DEG = 0.3, 1.0


def scans(options):
    path = options.list or os.path.join(os.path.dirname(os.path.abspath(__file__)), 'real_captures.txt')
    lines = [line.split() for line in open(path) if line.strip() and not line.startswith('#')]
    known = {words[0]: words[1:] for words in lines}
    return {name: known.get(name) for name in options.only} if options.only else known


def draw(options):
    """Prints a list of captures: what each is of, how it is taken and what goes wrong, each independent of the others."""
    rng = np.random.default_rng(options.seed)
    pick = lambda values, shares=None: values[int(rng.choice(len(values), p=shares))]
    between = lambda low, high, digits: f'{low + (high - low) * rng.random():.{digits}f}'
    print(f'# Drawn by real_captures.py draw {options.folder} --seed {options.seed}')
    for k in range(int(options.folder)):
        words = ['--object', pick(['vase', 'knot', 'rock', 'box', 'group']), '--texture', f'{0.06 * 6 ** rng.random():.2f}',
                 '--size', between(0.09, 0.19, 2), '--fill', between(0.4, 0.75, 2), '--disc', pick(['speckled', 'plain']),
                 '--background', pick(['cluttered', 'weak', 'bright', 'plain'], [0.4, 0.25, 0.15, 0.2]),
                 '--focal', pick(['0.8', '1', '1.2', '1.5', '2', '2.8']), '--grey_noise', pick(['0', '1', '2', '3']),
                 '--quality', pick(['95', '90', '80', '70']), '--seed', str(10000 * options.seed + k)]
        stations = pick([1, 2, 3], [0.5, 0.3, 0.2])
        low = 5 + 25 * rng.random()
        words += ['--stations', str(stations), '--elevations', f'{low:.0f}', f'{low + 12 * (stations - 1) * (1 + rng.random()):.0f}']
        words += pick([['--steps', pick(['24', '30', '36'])], ['--steps', pick(['16', '18', '20'])],
                       ['--steps', pick(['20', '26']), '--step', pick(['8', '12'])]], [0.5, 0.3, 0.2])
        words += pick([[], ['--width', '640', '--height', '480'], ['--width', '480', '--height', '640']], [0.5, 0.35, 0.15])
        sometimes = [(0.4, '--gloss', lambda: between(0.2, 0.8, 1)), (0.3, '--uneven', lambda: pick(['0.1', '0.4'])),
                     (0.4, '--k1', lambda: pick(['-0.3', '-0.15', '-0.05', '0.05'])),
                     (0.3, '--exposure_jumps', lambda: '2'), (0.3, '--balance_jumps', lambda: '1.5'),
                     (0.2, '--people', lambda: pick(['3', '6'])), (0.2, '--hands', lambda: pick(['1', '3'])),
                     (0.15, '--wobble', lambda: pick(['0.2', '0.5'])), (0.5, '--defocus', lambda: between(1, 6, 1)),
                     (0.5, '--vignette', lambda: between(0.1, 0.5, 1)), (0.5, '--sharpen', lambda: between(0.3, 1.2, 1)),
                     (0.25, '--shake', lambda: pick(['0.5', '1.5'])), (0.25, '--breathing', lambda: pick(['0.0005', '0.002']))]
        for share, word, value in sometimes:
            if rng.random() < share:
                words += [word, value()]
        print(f'd{options.seed}_{k:02d}', *words)


def render(options):
    script = os.path.join(os.path.dirname(os.path.abspath(__file__)), 'render_scene.py')

    def one(scan):
        name, words = scan
        folder = os.path.join(options.folder, name)
        if os.path.exists(f'{folder}/gt/scene.json'):
            return
        if words is None:
            sys.exit(f'the list has no scan {name}')
        start = time.time()
        subprocess.run([options.python, script, folder, *COMMON, *words], check=True)
        print(f'{name}: {time.time() - start:.0f} s', flush=True)
    with ThreadPoolExecutor(options.jobs) as pool:
        list(pool.map(one, scans(options).items()))


def run(options):
    def one(name):
        workspace = os.path.join(options.workspaces, name)
        os.makedirs(workspace, exist_ok=True)
        command = [options.s2gs, 'automatic_scanner', '--workspace_path', workspace, '--image_path',
                   f'{options.folder}/{name}/images', *options.options.split()]
        if options.colmap_path:
            command += ['--colmap_path', options.colmap_path]
        start = time.time()
        with open(f'{workspace}/log.txt', 'w') as log:
            code = subprocess.run(command, stdout=log, stderr=subprocess.STDOUT).returncode
        json.dump(dict(exit_code=code, seconds=time.time() - start), open(f'{workspace}/run.json', 'w'))
        print(f'{name}: exit code {code}, {time.time() - start:.0f} s', flush=True)
    with ThreadPoolExecutor(options.jobs) as pool:
        list(pool.map(one, scans(options)))


def read_poses(model):
    """cam_from_object rotations by base name, of a COLMAP model's images.bin."""
    import struct
    path, out = f'{model}/images.bin', {}
    if not os.path.exists(path):
        return out
    data, at = open(path, 'rb').read(), 8
    for _ in range(struct.unpack_from('<Q', data, 0)[0]):
        q = np.array(struct.unpack_from('<4d', data, at + 4))
        end = data.index(b'\0', at + 64)
        name = os.path.basename(data[at + 64:end].decode())
        at = end + 9 + 24 * struct.unpack_from('<Q', data, end + 1)[0]
        w, x, y, z = q / np.linalg.norm(q)
        out[name] = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                              [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                              [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])
    return out


def degrees(rotations):
    return np.degrees(np.arccos(np.clip((np.trace(rotations, axis1=-2, axis2=-1) - 1) / 2, -1, 1)))


def common_rotation(of, to):
    """The rotation Q for which `of` Q is nearest to `to`, robustly: reweighted by the errors."""
    weights = np.ones(len(of))
    for _ in range(20):
        u, _, vt = np.linalg.svd(np.einsum('k,kji,kjl->il', weights, of, to))
        q = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
        weights = 1 / np.maximum(degrees(np.einsum('kij,jl,kml->kim', of, q, to)), 0.02)
    return q


def frame_rotations(estimate, truth):
    """The rotations B and C of world and object for which B `estimate` C is nearest to `truth`, robustly. Both at once: one
    after the other would hardly move, since about the table's axis the one undoes what the other does."""
    def apart(x):
        b, c = Rotation.from_rotvec(x[:3]).as_matrix(), Rotation.from_rotvec(x[3:]).as_matrix()
        return np.degrees(Rotation.from_matrix(np.einsum('ij,kjl,lm,knm->kin', b, estimate, c, truth)).as_rotvec().ravel())
    fits = [least_squares(apart, [0, 0, start, 0, 0, 0], loss='soft_l1', f_scale=0.05) for start in np.arange(4) * np.pi / 2]
    x = min(fits, key=lambda fit: fit.cost).x
    return Rotation.from_rotvec(x[:3]).as_matrix(), Rotation.from_rotvec(x[3:]).as_matrix()


def read_json(path):
    try:
        return json.load(open(path))
    except (OSError, ValueError):
        return {}


def tied_sets(turntable):
    """Names of photos between which the scan says that it knows the table's angle."""
    sets = turntable.get('tied_stations') or [range(turntable.get('stations', 0))]
    return [[os.path.basename(i['name']) for i in turntable.get('images', []) if i['station'] in tied] for tied in sets]


def score_scan(folder, workspace):
    truth = {}
    for image in json.load(open(f'{folder}/gt/scene.json'))['images']:
        if image['split'] == 'train':
            pose = np.array(image['world_to_camera']) @ np.array(image['object_to_world'])
            truth[os.path.basename(image['file'])] = (pose[:3, :3], np.array(image['object_to_world'])[:3, :3])
    estimate = read_poses(f'{workspace}/sparse/0')
    names = sorted(set(truth) & set(estimate))
    report = read_json(f'{workspace}/split/turntable_mapper.json')
    verdict = report.get('verdict') or {}
    out = dict(photos=[len(names), len(truth)], case=report.get('case'), verdict=verdict.get('verdict', 'none'),
               reasons=verdict.get('reasons', []), **read_json(f'{workspace}/run.json'))
    if len(names) >= 3:
        R, T = np.array([estimate[n] for n in names]), np.array([truth[n][0] for n in names])
        q = common_rotation(R, T)
        rotation = degrees(np.einsum('kij,jl,kml->kim', R, q, T))
        out['rotation_deg'] = [float(np.median(rotation)), float(rotation.max())]
        turntable = read_json(f'{workspace}/turntable.json')
        turns = {os.path.basename(i['name']): np.array(i['object_to_world'])[:3, :3] for i in turntable.get('images', [])}
        if all(n in turns for n in names):
            angles = []
            out['angle_sets'] = len(tied_sets(turntable))
            for tied in tied_sets(turntable):
                tied = [n for n in tied if n in names]
                if len(tied) < 3:
                    continue
                E, W = np.array([turns[n] for n in tied]), np.array([truth[n][1] for n in tied])
                B, C = frame_rotations(E, W)
                angles.extend(degrees(np.einsum('ij,kjl,lm,knm->kin', B, E, C, W)))
            if angles:
                out['angle_deg'] = [float(np.median(angles)), float(np.max(angles))]
    right = len(names) == len(truth) and 'rotation_deg' in out
    for figure in ('rotation_deg', 'angle_deg'):
        right = right and out.get(figure, [0, 0])[0] <= MEDIAN_DEG and out.get(figure, [0, 0])[1] <= MAX_DEG
    out['right'] = bool(right)
    return out


def score(options):
    names, table = scans(options), {}
    print('| scan | photos | rotation | angle | verdict | right | exit | seconds |')
    print('|---|---|---|---|---|---|---|---|')
    for name in names:
        folder, workspace = f'{options.folder}/{name}', f'{options.workspaces}/{name}'
        if not (os.path.exists(f'{folder}/gt/scene.json') and os.path.isdir(workspace)):
            continue
        out = table[name] = score_scan(folder, workspace)
        pair = lambda figure: '{:.3f} / {:.2f}'.format(*out[figure]) if figure in out else 'none'
        wrong_good = out['verdict'] == 'good' and not out['right']
        angle = pair('angle_deg') + (f", {out['angle_sets']} sets" if out.get('angle_sets', 1) > 1 else '')
        print(f"| {name} | {out['photos'][0]} of {out['photos'][1]} | {pair('rotation_deg')} | {angle} | "
              f"{out['verdict']}{' **of a wrong scan**' if wrong_good else ''} | {'yes' if out['right'] else 'no'} | "
              f"{out.get('exit_code', '')} | {out.get('seconds', float('nan')):.0f} |")
    rows = table.values()
    print(f"\n{sum(r['right'] for r in rows)} of {len(rows)} right, {sum(r['verdict'] == 'good' for r in rows)} good, "
          f"{sum(r['verdict'] == 'good' and not r['right'] for r in rows)} good of wrong scans")
    if options.json:
        json.dump(table, open(options.json, 'w'), indent=1)


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument('do', choices=['render', 'run', 'score', 'draw'])
    p.add_argument('folder', help='of the scans; of draw: how many')
    p.add_argument('workspaces', nargs='?')
    p.add_argument('--only', nargs='+', default=[])
    p.add_argument('--python', default=sys.executable, help='with what render_scene.py needs')
    p.add_argument('--s2gs', default='s2gs')
    p.add_argument('--colmap_path', default='')
    p.add_argument('--json', default='')
    p.add_argument('--list', default='', help='of scans, instead of real_captures.txt')
    p.add_argument('--jobs', type=int, default=1, help='scans at a time')
    p.add_argument('--options', default='--until split', help='of automatic_scanner')
    p.add_argument('--seed', type=int, default=1, help='of draw')
    options = p.parse_args()
    if options.do in ('run', 'score') and not options.workspaces:
        p.error('the folder of workspaces is missing')
    {'render': render, 'run': run, 'score': score, 'draw': draw}[options.do](options)


if __name__ == '__main__':
    main()
