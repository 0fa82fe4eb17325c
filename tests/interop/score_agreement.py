#!/usr/bin/env python3
"""Shows that scan_evaluator agrees with an independent scorer, score_scan.py, on perturbed ground truth.

usage: score_agreement.py S2GS_PROGRAM SHARED_FOLDER [--seeds N] [--mesh_seeds N]

SHARED_FOLDER holds tools/score_scan.py and data/{falcon_desk,ogre_fixed}. From a data set's ground truth, workspaces
are made with known kinds of damage (poses, turntable, scale, masks, mesh), and both scorers measure them:
  poses, angles, scale   equal to 1e-6 degrees or percent
  mask IoU               equal to the last bit but rounding of the mean (1e-12)
  surfaces               exact distances of random samples to triangles: over several seeds, the means of both differ
                         by at most four standard errors
Exit code 0 when all agree. Needs numpy, scipy and OpenCV's Python module.
"""
import argparse
import importlib.util
import json
import os
import struct
import subprocess
import sys
import tempfile

import cv2
import numpy as np

POSE_TOLERANCE = 1e-6
IOU_TOLERANCE = 1e-12
# With 12 samplings each, chance exceeds this once in 1,700 comparisons (Student's t, 22 degrees of freedom).
MAX_STANDARD_ERRORS = 4


def load_scorer(shared):
    path = os.path.join(shared, 'tools', 'score_scan.py')
    spec = importlib.util.spec_from_file_location('score_scan', path)
    module = importlib.util.module_from_spec(spec)
    sys.dont_write_bytecode = True
    spec.loader.exec_module(module)
    # Figures with all their digits: the scorer rounds what it prints.
    module.med_max = lambda x: [float(np.median(x)), float(np.max(x))]
    module.round = lambda value, digits=0: value
    # Of a rough surface, the triangles of the eight nearest samples do not always hold the nearest triangle: its
    # distances come out 2 % long, with thirty-two samples .2 %. A fourth of the points costs the same.
    distance = module.surface_distance
    module.surface_distance = lambda points, *surface: distance(points[::4], *surface, k=32)
    return module


def run_scorer(scorer, workspace, scene, seed=0):
    """score_scan.main() with another seed of its sampling."""
    lines = []
    scorer.print = lines.append
    real = np.random.default_rng
    np.random.default_rng = lambda _: real(seed)
    argv, sys.argv = sys.argv, ['score_scan.py', workspace, scene, '--json', '--exact']
    try:
        scorer.main()
    finally:
        sys.argv = argv
        np.random.default_rng = real
    return json.loads(lines[0])


def run_program(program, workspace, scene, seed=0):
    path = os.path.join(workspace, f'figures-{seed}.json')
    subprocess.run([program, 'scan_evaluator', '--workspace_path', workspace, '--ground_truth_path', scene,
                    '--json_path', path, '--random_seed', str(seed), '--Mesh.thresholds_pct', '1'],
                   check=True, stdout=subprocess.DEVNULL)
    return json.load(open(path))


def rotation(axis, angle):
    axis = np.asarray(axis, float) / np.linalg.norm(axis)
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def random_rotation(rng):
    return rotation(rng.normal(size=3), rng.uniform(0.2, 3))


def rot_to_quat(r):
    """Of the four equivalent formulas the one with the largest divisor."""
    candidates = np.array([1 + r[0, 0] + r[1, 1] + r[2, 2], 1 + r[0, 0] - r[1, 1] - r[2, 2],
                           1 - r[0, 0] + r[1, 1] - r[2, 2], 1 - r[0, 0] - r[1, 1] + r[2, 2]])
    i = int(np.argmax(candidates))
    s = 2 * np.sqrt(candidates[i])
    if i == 0:
        q = [s / 4, (r[2, 1] - r[1, 2]) / s, (r[0, 2] - r[2, 0]) / s, (r[1, 0] - r[0, 1]) / s]
    elif i == 1:
        q = [(r[2, 1] - r[1, 2]) / s, s / 4, (r[0, 1] + r[1, 0]) / s, (r[0, 2] + r[2, 0]) / s]
    elif i == 2:
        q = [(r[0, 2] - r[2, 0]) / s, (r[0, 1] + r[1, 0]) / s, s / 4, (r[1, 2] + r[2, 1]) / s]
    else:
        q = [(r[1, 0] - r[0, 1]) / s, (r[0, 2] + r[2, 0]) / s, (r[1, 2] + r[2, 1]) / s, s / 4]
    return np.array(q) / np.linalg.norm(q)


def write_model(folder, poses, scene):
    os.makedirs(folder)
    with open(os.path.join(folder, 'cameras.bin'), 'wb') as f:
        f.write(struct.pack('<QIiQQ4d', 1, 1, 1, scene['width'], scene['height'], scene['fx'], scene['fy'],
                            scene['cx'], scene['cy']))
    with open(os.path.join(folder, 'points3D.bin'), 'wb') as f:
        f.write(struct.pack('<Q', 0))
    with open(os.path.join(folder, 'images.bin'), 'wb') as f:
        f.write(struct.pack('<Q', len(poses)))
        for i, (name, t) in enumerate(poses.items()):
            f.write(struct.pack('<I7dI', i + 1, *rot_to_quat(t[:3, :3]), *t[:3, 3], 1))
            f.write(name.encode() + b'\0' + struct.pack('<Q', 0))


def write_ply(path, vertices, triangles):
    with open(path, 'wb') as f:
        f.write((f'ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\nproperty float x\n'
                 f'property float y\nproperty float z\nelement face {len(triangles)}\n'
                 'property list uchar int vertex_indices\nend_header\n').encode())
        f.write(np.asarray(vertices, '<f4').tobytes())
        faces = np.zeros(len(triangles), np.dtype([('n', 'u1'), ('v', '<i4', 3)]))
        faces['n'], faces['v'] = 3, triangles
        f.write(faces.tobytes())


def moved(cam_from_truth, truth_from_estimate, rng, angle_deg, length):
    """The camera in the estimate's frame, with an error of its own."""
    s, r, t = truth_from_estimate
    centre = -cam_from_truth[:3, :3].T @ cam_from_truth[:3, 3] + rng.normal(size=3) * length
    turn = rotation(rng.normal(size=3), np.radians(angle_deg) * rng.uniform(0.2, 1))
    out = np.eye(4)
    out[:3, :3] = turn @ cam_from_truth[:3, :3] @ r
    out[:3, 3] = -out[:3, :3] @ (r.T @ (centre - t) / s)
    return out


def damaged_mask(label, kind, rng):
    mask = (label > 0).astype(np.uint8) * 255
    size = int(rng.integers(3, 12))
    kernel = np.ones((size, size), np.uint8)
    if kind == 0:
        return cv2.erode(mask, kernel)
    if kind == 1:
        return cv2.dilate(mask, kernel)
    if kind == 2:
        return np.roll(mask, (size, -size), (0, 1))
    if kind == 3:  # another size, also one that does not divide
        return cv2.resize(mask, (int(rng.integers(100, 900)), int(rng.integers(100, 900))))
    if kind == 4:  # greys on both sides of the threshold
        return cv2.GaussianBlur(mask, (31, 31), 9)
    return np.where(label == 255, 255, 0).astype(np.uint8)


def make_workspace(folder, scene_folder, seed, scorer):
    rng = np.random.default_rng(1000 + seed)
    scene = json.load(open(f'{scene_folder}/gt/scene.json'))
    name_of = lambda image: os.path.basename(image['file'])
    train = [i for i in scene['images'] if i['split'] == 'train']
    similarity = (10 ** rng.uniform(-2, 2), random_rotation(rng), rng.normal(size=3))
    # The background has its own frame and a scale that is a little off.
    static_similarity = (similarity[0] * (1 + rng.normal() * 0.01), random_rotation(rng), rng.normal(size=3))
    kept = [i for i in train if rng.random() > 0.1]
    angle, length = 10 ** rng.uniform(-3, 0.5), 10 ** rng.uniform(-5, -2.5)
    world = {name_of(i): np.array(i['world_to_camera']) for i in kept}
    turn = {name_of(i): np.array(i['object_to_world']) for i in kept}
    write_model(f'{folder}/sparse/0',
                {n: moved(world[n] @ turn[n], similarity, rng, angle, length) for n in world}, scene)
    # Two sub-folders: names are told apart by the file alone.
    write_model(f'{folder}/sparse/static',
                {f'sub{k % 2}/{n}': moved(world[n], static_similarity, rng, angle, length)
                 for k, n in enumerate(world)}, scene)

    axis = random_rotation(rng)[0]
    sense = 1 if seed % 2 == 0 else -1
    images = []
    for i in kept:
        degrees = sense * (i['angle_deg'] + rng.normal() * 10 ** rng.uniform(-3, 0.5))
        m = np.eye(4)
        m[:3, :3] = rotation(axis, np.radians(degrees + 33))
        images.append({'name': name_of(i), 'station': 0, 'angle_deg': degrees % 360, 'object_to_world': m.tolist()})
    json.dump({'version': 1, 'axis': {'point': [0, 0, 0], 'direction': axis.tolist()}, 'stations': 1,
               'scale_observable': False, 'units': 'sfm', 'images': images}, open(f'{folder}/turntable.json', 'w'))

    os.makedirs(f'{folder}/masks')
    for k, i in enumerate(train):
        if rng.random() < 0.1:
            continue
        stem = os.path.splitext(name_of(i))[0]
        label = cv2.imread(f'{scene_folder}/gt/masks/{stem}.png', 0)
        name = f'{stem}.png' if k % 7 == 0 else f'{name_of(i)}.png'
        cv2.imwrite(f'{folder}/masks/{name}', damaged_mask(label, int(rng.integers(0, 6)), rng))

    v, t = scorer.read_ply(f'{scene_folder}/gt/object.ply')
    d, dt = scorer.read_ply(f'{scene_folder}/gt/disc.ply')
    diameter = np.linalg.norm(v.max(0) - v.min(0))
    noise = (0.001 + 0.004 * rng.random()) * diameter
    keep = rng.random(len(t)) > 0.02
    hole = np.linalg.norm(v[t].mean(1) - v[rng.integers(len(v))], axis=1) < 0.08 * diameter
    parts = [(v + rng.normal(size=v.shape) * noise, t[keep & ~hole]), (d, dt)]
    for _ in range(20):  # outliers: small triangles anywhere around
        centre = v.mean(0) + rng.normal(size=3) * 0.4 * diameter
        parts.append((centre + rng.normal(size=(3, 3)) * 0.02 * diameter, np.array([[0, 1, 2]])))
    offsets = np.cumsum([0] + [len(p[0]) for p in parts[:-1]])
    vertices = np.vstack([p[0] for p in parts])
    triangles = np.vstack([p[1] + o for p, o in zip(parts, offsets)])
    s, r, shift = similarity
    os.makedirs(f'{folder}/dense/0')
    write_ply(f'{folder}/dense/0/meshed-tsdf.ply', (vertices - shift) @ r / s, triangles)


class Comparison:
    def __init__(self):
        self.failures, self.count, self.worst = [], 0, {}

    def check(self, where, name, theirs, ours, tolerance):
        self.count += 1
        difference = abs(theirs - ours)
        self.worst[name] = max(self.worst.get(name, 0), difference)
        if not difference <= tolerance:
            self.failures.append(f'{where}: {name}: {theirs!r} by score_scan.py, {ours!r} by s2gs')


def compare_exact(result, where, theirs, ours):
    """Everything but the sampled surfaces."""
    figures, missing = ours['figures'], ours['missing']
    for name in ('object_rot_deg', 'object_centre_pct', 'static_rot_deg', 'static_centre_pct', 'angle_deg'):
        if not isinstance(theirs.get(name), list):
            if name not in missing:
                result.failures.append(f'{where}: {name} is missing for score_scan.py but not for s2gs')
            continue
        for k, statistic in enumerate(('median', 'max')):
            result.check(where, name, theirs[name][k], figures[name][statistic], POSE_TOLERANCE)
    if 'scale_err_pct' in theirs:
        result.check(where, 'scale_err_pct', theirs['scale_err_pct'], figures['scale_err_pct']['value'], POSE_TOLERANCE)
    for name in ('registered', 'angle_images', 'mask_images'):
        for k, statistic in enumerate(('value', 'of')):
            result.check(where, name, theirs[name][k], figures[name][statistic], 0)
    for name in ('mask_iou', 'object_iou'):
        result.check(where, name, theirs[name], figures[name]['mean'], IOU_TOLERANCE)


def compare_surfaces(result, where, theirs, ours):
    print(f'{where}: surfaces, mean (sd) over {len(theirs)} seeds by score_scan.py and {len(ours)} by s2gs')
    for name in ('chamfer_pct', 'accuracy_pct', 'completeness_pct', 'f1_1pct', 'gt_seen_pct', 'outside_box_pct'):
        a = np.array([t[name] for t in theirs])
        b = np.array([o['figures'][name]['value'] for o in ours])
        error = np.sqrt(a.var(ddof=1) / len(a) + b.var(ddof=1) / len(b))
        z = abs(a.mean() - b.mean()) / max(error, 1e-300)
        print(f'  {name:18s} {a.mean():.6f} ({a.std(ddof=1):.6f})   {b.mean():.6f} ({b.std(ddof=1):.6f})   '
              f'difference {z:.1f} standard errors, allowed {MAX_STANDARD_ERRORS}')
        result.check(where, name, a.mean(), b.mean(), MAX_STANDARD_ERRORS * error)
    result.check(where, 'faces', theirs[0]['faces'], ours[0]['figures']['faces']['value'], 0)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('program')
    parser.add_argument('shared')
    parser.add_argument('--seeds', type=int, default=4, help='workspaces per data set')
    parser.add_argument('--mesh_seeds', type=int, default=12, help='samplings of one workspace per data set')
    parser.add_argument('--data_sets', nargs='+', default=['falcon_desk', 'ogre_fixed'],
                        help="names in SHARED_FOLDER/data, or folders")
    args = parser.parse_args()
    scorer = load_scorer(args.shared)
    result = Comparison()
    with tempfile.TemporaryDirectory() as temporary:
        for data_set in args.data_sets:
            scene = os.path.join(args.shared, 'data', data_set)  # a folder stays as it is
            data_set = os.path.basename(os.path.normpath(data_set))
            for seed in range(args.seeds):
                where = f'{data_set}, workspace {seed}'
                workspace = os.path.join(temporary, f'{data_set}-{seed}')
                make_workspace(workspace, scene, seed, scorer)
                mesh = f'{workspace}/dense/0/meshed-tsdf.ply'
                if seed > 0:  # one mesh per data set: surfaces take most of the time
                    os.remove(mesh)
                seeds = range(args.mesh_seeds if seed == 0 else 1)
                theirs = [run_scorer(scorer, workspace, scene, k) for k in seeds]
                ours = [run_program(args.program, workspace, scene, k) for k in seeds]
                compare_exact(result, where, theirs[0], ours[0])
                if seed == 0:
                    compare_surfaces(result, where, theirs, ours)
    print('largest differences:')
    for name, difference in result.worst.items():
        print(f'  {name:18s} {difference:.3g}')
    for failure in result.failures:
        print('DISAGREE ' + failure)
    print(f'{result.count - len(result.failures)} of {result.count} figures agree')
    return 1 if result.failures else 0


if __name__ == '__main__':
    sys.exit(main())
