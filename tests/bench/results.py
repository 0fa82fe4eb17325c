"""Result files: one small JSON a run, tests/bench/results/SUITE/SCENE[.VARIANT].SEED.MACHINE.json."""
import json
import pathlib
import re
import subprocess

HERE = pathlib.Path(__file__).resolve().parent
RESULTS = HERE / 'results'
CURVES = 'curves'  # folder of RESULTS: what work_precision wrote
KEYS = ('suite', 'scene', 'variant', 'seed', 'commit', 'machine', 'command', 'data_hash', 'recorded', 'exit_code', 'figures')
MACHINE_KEYS = ('name', 'cpu', 'cores', 'gpu')
# What is better: less (-1) or more (1), by the last word before the statistic; others are not judged.
BETTER = [(r'(rot_deg|centre_pct|angle_deg|axis_deg|axis_offset_pct|scale_err_pct|focal_err_pct|chamfer\w*_pct|'
           r'accuracy\w*_pct|completeness\w*_pct|outside_box_pct|spill_pct|miss_pct|tilt_deg|seconds|_ms|_mib|error_voxels)\b', -1),
          (r'(registered|angle_images|mask_images|auc|iou|f1\w*pct|psnr_db|ssim|gt_seen_pct)\b', 1)]


def direction(figure):
    """-1: less is better, 1: more is, 0: neither."""
    return next((sign for pattern, sign in BETTER if re.search(pattern, figure.split('.')[0])), 0)


def check_result(result):
    """What is wrong with a result, or None."""
    missing = [key for key in KEYS if key not in result]
    if missing:
        return 'lacks ' + ', '.join(missing)
    if lacking := [key for key in MACHINE_KEYS if key not in result['machine']]:
        return 'its machine lacks ' + ', '.join(lacking)
    if result['recorded'] not in ('by run.py', 'by hand'):
        return 'is recorded neither by run.py nor by hand'
    if bad := [k for k, v in result['figures'].items() if isinstance(v, bool) or not isinstance(v, (int, float))]:
        return 'has figures that are not numbers: ' + ', '.join(bad)
    return None


def key_of(result):
    """What a result is a measurement of, apart from program and seed."""
    return result['suite'], result['scene'], result['variant'], result['machine']['name']


def file_name(result):
    parts = [result['scene'], result['variant'], str(result['seed']), result['machine']['name']]
    slug = '.'.join(re.sub(r'[^A-Za-z0-9_+-]+', '-', part) for part in parts if part != '')
    return f'{result["suite"]}/{slug}.json'


def write_result(folder, result):
    if fault := check_result(result):
        raise ValueError(f'this result {fault}')
    path = pathlib.Path(folder) / file_name(result)
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_suffix('.unfinished')
    # Seven digits that count are more than any figure is good for.
    result = {**result, 'figures': {k: float(f'{v:.7g}') for k, v in result['figures'].items()}}
    unfinished.write_text(json.dumps(result, indent=1, ensure_ascii=False, sort_keys=True) + '\n')
    unfinished.rename(path)
    return path


def parse(text, where):
    result = json.loads(text)
    if fault := check_result(result):
        raise ValueError(f'{where} {fault}')
    return result


def read_results(where):
    """All results of a folder, or of a commit of this repository (its tests/bench/results), but for what
    work_precision wrote (curves/), which has a form of its own: read_curves()."""
    folder = pathlib.Path(where)
    if folder.is_dir():
        return [parse(path.read_text(), path) for path in sorted(folder.rglob('*.json')) if path.parent.name != CURVES]
    git = ['git', '-C', str(HERE)]
    listed = subprocess.run([*git, 'ls-tree', '-r', '--name-only', '--full-tree', str(where), 'tests/bench/results/'],
                            capture_output=True, text=True)
    if listed.returncode != 0:
        raise FileNotFoundError(f'{where}: neither a folder nor a commit')
    names = [name for name in listed.stdout.split('\n')
             if name.endswith('.json') and pathlib.PurePosixPath(name).parent.name != CURVES]
    return [parse(subprocess.run([*git, 'show', f'{where}:{name}'], check=True, capture_output=True, text=True).stdout,
                  f'{where}:{name}') for name in names]


def read_curves(folder=RESULTS):
    """{name: content} of what `s2gs work_precision` wrote into FOLDER/curves: sweeps ("settings") and parts that
    were left out and forced ("parts")."""
    return {path.stem: json.loads(path.read_text()) for path in sorted((pathlib.Path(folder) / CURVES).glob('*.json'))}
