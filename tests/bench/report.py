#!/usr/bin/env python3
"""Writes BENCHMARK.md, its page of sweeps, its plots and the figures of README.md from the result files.

usage: report.py [--check] [--results FOLDER] [--output FOLDER]

--check writes nothing and fails when a file is not what would be written. Where a run was repeated with several seeds,
the median stands in the table and the range behind it.
"""
import argparse
import math
import pathlib
import re
import statistics
import sys

import results
import scenes

BEGIN, END = '<!-- figures: begin (tests/bench/report.py writes what stands here) -->', '<!-- figures: end -->'


# --- Numbers ------------------------------------------------------------------------------------------------

def digits(value):
    """Three figures that count, whole numbers in full."""
    if value == int(value) or abs(value) >= 1000:
        return f'{value:,.0f}'
    text = f'{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}'
    return text.rstrip('0').rstrip('.') if '.' in text else text


def cell(runs, *names, scale=1):
    """Medians over the runs of one or two figures, joined by a slash; the range where there are several runs."""
    parts = []
    for name in names:
        values = [scale * run['figures'][name] for run in runs if name in run['figures']]
        if not values:
            return ''
        text = digits(statistics.median(values))
        if len(values) > 1 and digits(min(values)) != digits(max(values)):
            text += f' ({digits(min(values))} to {digits(max(values))})'
        parts.append(text)
    return ' / '.join(parts)


def counts(runs, name):
    """"60 of 60", the fewest of all runs."""
    pairs = [(r['figures'][f'{name}.value'], r['figures'].get(f'{name}.of')) for r in runs if f'{name}.value' in r['figures']]
    if not pairs:
        return ''
    value, of = min(pairs, key=lambda p: p[0])
    return digits(value) + (f' of {digits(of)}' if of else '')


def provenance(runs):
    return f'{runs[0]["machine"]["name"]}, {", ".join(sorted({run["commit"][:7] for run in runs}))}'


def table(header, rows):
    if not rows:
        return ['Not measured yet.', '']
    return ['| ' + ' | '.join(header) + ' |', '|' + '---|' * len(header),
            *('| ' + ' | '.join(row) + ' |' for row in rows), '']


class Results:
    def __init__(self, all_results):
        self.order = {name: i for i, name in enumerate(scenes.read_scenes())}
        self.groups = {}
        for result in sorted(all_results, key=lambda r: (r['suite'], self.order.get(r['scene'], 99), r['variant'],
                                                         r['machine']['name'], r['seed'])):
            self.groups.setdefault(results.key_of(result), []).append(result)

    def of(self, suite, scene=None, variant=None, gpu=None):
        """[(scene, variant, runs)]"""
        return [(key[1], key[2], runs) for key, runs in self.groups.items()
                if key[0] == suite and scene in (None, key[1]) and variant in (None, key[2])
                and gpu in (None, runs[0]['machine']['gpu'] is not None)]

    def one(self, suite, scene, variant='', gpu=False):
        found = self.of(suite, scene, variant, gpu)
        return found[-1][2] if found else []


def name_cell(scene, variant, runs):
    failed = sum(run['exit_code'] != 0 for run in runs)
    text = scene + (f', {variant}' if variant else '')
    return text + (f' (FAILED: {failed} of {len(runs)})' if failed else '')


def time_cell(runs, prefix=''):
    """Wall seconds on a GPU, CPU seconds otherwise: what a loaded machine does not change."""
    if not runs[0]['machine']['gpu'] and (seconds := cell(runs, prefix + 'cpu_seconds')):
        return seconds + ' CPU s'
    seconds = cell(runs, prefix + 'wall_seconds')
    return seconds + ' s' if seconds else ''


# --- The page -----------------------------------------------------------------------------------------------

def verdict_cell(runs):
    """What the program itself says of the poses."""
    called = [run['figures']['called_good'] for run in runs if 'called_good' in run['figures']]
    return '' if not called else 'good' if all(called) else 'doubtful' if not any(called) else 'some doubtful'


def poses_table(r):
    return table(['scene', 'placed', 'called', 'rotation, median / max [°]', 'centre [%]', 'table angle [°]', 'scale [%]', 'time', 'machine, commit'],
                 [[name_cell(s, v, runs), counts(runs, 'registered'), verdict_cell(runs), cell(runs, 'object_rot_deg.median', 'object_rot_deg.max'),
                   cell(runs, 'object_centre_pct.median', 'object_centre_pct.max'),
                   cell(runs, 'angle_deg.median', 'angle_deg.max'), cell(runs, 'scale_err_pct.value'), time_cell(runs),
                   provenance(runs)] for s, v, runs in r.of('poses')])


def surface_cells(runs):
    return [cell(runs, 'mask_iou.mean'), cell(runs, 'chamfer_pct.value'), cell(runs, 'f1_1pct.value'),
            cell(runs, 'chamfer_sampled_pct.value'), cell(runs, 'f1_sampled_1pct.value')]


SURFACE_HEADER = ['masks IoU', 'Chamfer [%]', 'F1 at 1 %', 'to samples: Chamfer [%]', 'F1']


def scan_table(r, suite):
    return table(['scene', *SURFACE_HEADER, 'time', 'machine, commit'],
                 [[name_cell(s, v, runs), *surface_cells(runs), time_cell(runs), provenance(runs)] for s, v, runs in r.of(suite)])


def train_table(r):
    def start(runs):
        points = [run['figures'].get('start_points') for run in runs]
        return '' if None in points else 'at random' if max(points) == 0 else f'{cell(runs, "start_points")} points'

    return table(['scene', 'start', 'iterations', 'Gaussians', 'PSNR [dB]', 'on object pixels', 'SSIM', 'masks IoU', 'training', 'machine, commit'],
                 [[name_cell(s, v, runs), start(runs), cell(runs, 'iteration'), cell(runs, 'count'), cell(runs, 'psnr_db'), cell(runs, 'object_psnr_db'),
                   cell(runs, 'ssim'), cell(runs, 'mask_iou'),
                   time_cell(runs, 'train_'), provenance(runs)] for s, v, runs in r.of('train')])


def kernel_names(figures, gpu):
    """Of a kernel's figures: CPU seconds in place of wall seconds as in time_cell(), last the load that other times were measured at."""
    has_cpu_seconds = {n.replace('_cpu_seconds', '_seconds') for n in figures if n.endswith('_cpu_seconds')}
    return sorted(n for n in figures if n not in ('cpu_seconds', 'wall_seconds', 'load') and (gpu or n not in has_cpu_seconds)) \
        + (['load'] if 'load' in figures else [])


def kernels_table(r):
    rows = []
    for scene, variant, runs in r.of('kernels'):
        names = kernel_names({n for run in runs for n in run['figures']}, runs[0]['machine']['gpu'])
        rows.append([name_cell(scene, variant, runs), '; '.join(f'{n} {cell(runs, n)}' for n in names), provenance(runs)])
    return table(['', 'measured', 'machine, commit'], rows)


def safety_lines(r):
    """Sums over the groups of the hostile cases, each fuzz target, killed scans."""
    lines = []
    for _, variant, runs in r.of('safety', 'hostile'):
        sums = {}
        for name, value in runs[-1]['figures'].items():
            kind = name.split('.', 1)[1]
            sums[kind] = sums.get(kind, 0) + value
        lines += [f'Hostile cases, {variant} form ({provenance(runs)}): ' + ', '.join(f'{k} {digits(v)}' for k, v in sums.items()) + '.', '']
    for _, variant, runs in r.of('safety', 'kills'):
        lines += [f'Killed scans, {variant} ({provenance(runs)}): ' + ', '.join(f'{k} {cell(runs, k)}' for k in runs[0]['figures']) + '.', '']
    return lines + table(['fuzz target', 'executions', 'CPU s', 'edges', 'faults', 'machine, commit'],
                         [[v, cell(runs, 'executions'), cell(runs, 'cpu_seconds'), cell(runs, 'edges'), cell(runs, 'faults'),
                           provenance(runs)] for _, v, runs in r.of('safety', 'fuzz')])


def curves_part(written):
    """Error against run time: a table and a diagram a sweep, then what was left out and forced. Links are those of CURVES_PAGE."""
    lines = []
    for name, curve in written.items():
        if 'settings' not in curve:
            continue
        clock = clock_of(curve)
        lines += [f'## {curve_title(name, curve)}', '',
                  f'Knob `{curve["knob"]}`; error: {curve["error_text"]}, against {curve["reference"]}. Medians over seeds '
                  f'(least to largest). [Page of diagrams](curves/{name}.html), '
                  f'[CSV](curves/{name}.csv).', '', *made_lines(curve)]
        for scene_index, scene in enumerate(curve['scenes']):
            rows = [[s['value'], spread_cell(s[f'{clock}_s']), spread_cell(s['error']), f'{s["reached"]} of {s["runs"]}',
                     'yes' if s['pareto'] else ''] for s in curve['settings'] if s['scene'] in (scene, scene_index)]
            if len(curve['scenes']) > 1:
                lines += [f'{scene}:', '']
            lines += table(['value', f'{CLOCKS[clock]} [s]', 'error', 'reached', 'nothing beats it in both'], rows)
        lines += [f'![error over {CLOCKS[clock]} seconds](../plots/curve_{name}.svg)', '']
    rows = [[p['scene'], p['what'], p['error_of'], spread_cell(p['planned_error']), spread_cell(p['forced_error']),
             gain_cell(p), sigmas_cell(p), spread_cell(p['planned_cpu_s']), spread_cell(p['forced_cpu_s']), name]
            for name, written_file in written.items() for p in written_file.get('parts', [])]
    if rows:
        lines += ['## What was left out, and forced', '',
                  'Each part that the plan (`s2gs scan_planner`) leaves out, run all the same by `s2gs work_precision --forced 1`: '
                  'gain is by how much that lowers the error; CPU seconds are those of the stages from the part on. A rotation error of poses is '
                  'one number, the tilt that all photos of a station share: what gains less than its standard deviation may be chance. Elsewhere, '
                  'from three seeds on, gain is the mean over runs of one seed with its standard error.', '',
                  *table(['scene', 'part', 'error', 'as planned', 'forced', 'gain', 'in standard deviations', 'CPU [s]', 'forced', 'file'], rows),
                  *[f'- `{name}`: {made_lines(one)[0]}' for name, one in written.items() if 'parts' in one and made_lines(one)], '']
    return lines


def mean_gain(part):
    """Of the runs of one seed, and its standard error [%]; None where seeds are too few or tell poses."""
    sigma, planned = part.get('gain_sigma'), part['planned_error']['median']
    if sigma is None or not planned or 'poses' in part['error_of'] or 'angles' in part['error_of']:
        return None
    mean = part['mean_gain'] if part.get('mean_gain') is not None else (part.get('gain_sigmas') or 0) * sigma
    return 100 * mean / planned, 100 * sigma / planned


def gain_cell(part):
    if found := mean_gain(part):
        return '{:+.2f} ± {:.2f} %'.format(*found)
    return '' if part['gain_pct'] is None else f'{part["gain_pct"]:+.2f} %'


def sigmas_cell(part):
    gain = part.get('gain_sigmas')
    if gain is None and part['gain_pct'] is not None and part.get('gain_sigma'):
        gain = (part["planned_error"]["median"] - part["forced_error"]["median"]) / part["gain_sigma"]
    return '' if gain is None else f'{gain:+.2f}'


def made_lines(written):
    made = written.get('made')
    return [f'`{made["command"]}`; {made["commit"]}; {made["machine"]}.', ''] if made else []


CLOCKS = {'cpu': 'CPU', 'wall': 'wall'}
CURVES_PAGE = 'tests/bench/results/curves.md'
PLOTTED = ('training_gpu', 'mesh_voxel')  # on the first page


def clock_of(curve):
    return curve.get('time', 'cpu')


def spread_cell(spread):
    if spread['median'] is None:
        return 'not reached'
    text = digits(spread['median'])
    low, high = digits(spread['min']), digits(spread['max'])
    return text if low == high else f'{text} ({low} to {high})'


def page(r, notes, written=None):
    lines = ['# Measurements', '',
             'This page is made: `tests/bench/run.py SUITE` measures and leaves one file a run in `tests/bench/results` (command, commit,',
             'machine, seed, hash of the photos, all figures), `tests/bench/report.py` writes this page and the figures of README.md from',
             'them, `tests/bench/compare.py A B` names what got worse between two folders or commits.', '',
             '    tests/bench/run.py                                             # after `bash tests/run.sh`: the CPU half',
             '    tests/bench/run.py --gpu --program s2gs --tools FOLDER --data FOLDER      # the GPU half, on a bare node', '',
             'Scenes and how the made-up ones are rendered: `tests/bench/scenes.json`. Lengths are in % of the object\'s diameter. Chamfer-L1 =',
             '(mean accuracy + mean completeness) / 2, exact distances of samples of one surface to the triangles of the other; "to samples" is',
             'the older figure, which has a floor of about .1 %. Several seeds: median (range). CPU seconds are of all threads.', '',
             '## Photos to poses', '', *poses_table(r),
             '## Photos to mesh', '', *scan_table(r, 'scan'),
             '## Training with exact poses: photos never seen', '', *train_table(r)]
    if curves(r):
        lines += ['![PSNR on object pixels over seconds of training](tests/bench/plots/train.svg)', '']
    lines += ['## Mesh of these models', '', *scan_table(r, 'mesh'), '## Kernels', '', *kernels_table(r),
              '## Hostile input', '', 'What is counted, and the commands: [CONTRIBUTING.md](CONTRIBUTING.md#hostile-input).', '', *safety_lines(r),
              '## Numerics', '', 'Each bound with the value that the tests measure: [numerics](tests/bench/results/numerics.md), made by',
              '`python3 tests/bench/numerics.py BUILD/tests --backend cpu` and, where a GPU is, `--backend cuda`, which make this and the two',
              'pages that follow. Training, drawing and meshing at the ends of what numbers allow (`numerics_stress`, small in every run of the',
              'tests, at full size on a GPU): [stress](tests/bench/results/numerics_stress.md).', '',
              *stiffness_lines(),
              *growth_lines(),
              *method_lines(),
              *curves_lines(written),
              '## Notes', '', 'What was tried, with what it gave, also where it did not pay:', '']
    return '\n'.join(lines + [f'- [{title}]({path})' for title, path in notes]) + '\n'


def stiffness_lines():
    if not (results.RESULTS / 'stiffness.md').exists():
        return []
    return ['Where problems are badly conditioned, what happens there, what helps, and what that costs and gains:',
            '[stiffness](tests/bench/results/stiffness.md).', '']


def growth_lines():
    if not (results.RESULTS / 'growth.md').exists():
        return []
    return ['## Growth', '', 'Seconds of each stage, memory and pairs against the number of photos and their size, and which of '
            'them grow faster than either:', '[growth](tests/bench/results/growth.md).', '']


def method_lines():
    if not (results.RESULTS / 'method.md').exists():
        return []
    return ['## The method\'s own tables', '', 'What each regulariser, the start and the freezing of p give, beside 2DGS with and without '
            'masks: [method](tests/bench/results/method.md),', 'made by `tests/bench/method_tables.py`.', '']


def curve_title(name, curve):
    return f'{curve["what"][0].upper()}{curve["what"][1:]} ({name.replace("_", " ")})'


CLOCKS_TEXT = ('Made by `s2gs work_precision`; CPU seconds are those of the process with what it starts, user and system, because the machines '
               'were shared: they are counts of work, not of waiting. Wall seconds are of runs on a GPU; the host had other work beside. '
               'Which settings each sweep had: [time]({}tests/bench/notes/time.md).')


def curves_page(written):
    """CURVES_PAGE: every sweep."""
    return '\n'.join(['# Error against run time', '', 'This page is made (`tests/bench/report.py`). ' + CLOCKS_TEXT.format('../../../'), '',
                      *curves_part(written)]).rstrip('\n') + '\n'


def best_values(curve, scene_index, scene):
    """The values that nothing beats in both, the fastest first."""
    own = [s for s in curve['settings'] if s['scene'] in (scene, scene_index) and s['pareto']]
    clock = clock_of(curve)
    return [s['value'] for s in sorted(own, key=lambda s: s[f'{clock}_s']['median'])]


def curves_lines(written):
    """One row a sweep, and the plots of PLOTTED."""
    if not written:
        return []
    rows = []
    for name, curve in written.items():
        if 'settings' not in curve:
            continue
        best = [f'{scene}: ' + ', '.join(str(v) for v in best_values(curve, i, scene)) for i, scene in enumerate(curve['scenes'])]
        rows.append([curve_title(name, curve), f'`{curve["knob"]}`', curve['error_text'], CLOCKS[clock_of(curve)], '; '.join(best)])
    lines = ['## Error against run time', '', CLOCKS_TEXT.format('') + f' Each sweep with its figures and its diagram: [curves]({CURVES_PAGE}); '
             'and there, too, what the plan leaves out, run all the same.', '']
    lines += table(['sweep', 'knob', 'error', 'time', 'what no other value beats in both, the fastest first'], rows) if rows else []
    for name in PLOTTED:
        if 'settings' in written.get(name, {}):
            lines += [f'![error over {CLOCKS[clock_of(written[name])]} seconds, {name.replace("_", " ")}](tests/bench/plots/curve_{name}.svg)', '']
    return [*lines, *plan_lines()]


def plan_lines():
    if not (results.RESULTS / 'plans.md').exists():
        return []
    return ['What each of five scenes leaves out, by which measurement: [plans](tests/bench/results/plans.md), made by '
            '`s2gs scan_planner` and `tests/bench/plans.py`.', '']


def note_titles(folder):
    return [(path.read_text().split('\n')[0].lstrip('# '), f'tests/bench/notes/{path.name}') for path in sorted(folder.glob('*.md'))]


# --- A plot -------------------------------------------------------------------------------------------------

def curves(r):
    return [(f'{scene}, {variant}' if variant else scene, runs[0]['curve']) for scene, variant, runs in r.of('train', gpu=True)
            if runs[0].get('curve')]


def plot(named, x_title, y_title, width=640, height=300):
    """Lines over a logarithmic x, as SVG. `named`: [(name, [[x, y], ...])]"""
    xs = [math.log10(x) for _, points in named for x, _ in points]
    ys = [y for _, points in named for _, y in points]
    x0, x1, y0, y1 = min(xs), max(xs), math.floor(min(ys)), math.ceil(max(ys))
    at = lambda x, y: (50 + (math.log10(x) - x0) / max(x1 - x0, 1e-9) * (width - 240), height - 40 - (y - y0) / max(y1 - y0, 1e-9) * (height - 60))
    colours = ('#1f5fa8', '#c0392b', '#2e8b57', '#8e6b23', '#6c3483')
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="12">',
           f'<rect width="{width}" height="{height}" fill="white"/>']
    for y in range(y0, y1 + 1, max(1, (y1 - y0) // 6)):
        left, top = at(10 ** x0, y)
        out.append(f'<path d="M{left:.0f} {top:.1f}H{width - 190}" stroke="#ddd"/><text x="{left - 6:.0f}" y="{top + 4:.1f}" text-anchor="end">{y}</text>')
    for x in (1, 3, 10, 30, 100, 300, 1000, 3000):
        if x0 <= math.log10(x) <= x1:
            left, top = at(x, y0)
            out.append(f'<path d="M{left:.1f} 20V{top:.0f}" stroke="#ddd"/><text x="{left:.1f}" y="{top + 16:.0f}" text-anchor="middle">{x}</text>')
    for i, (name, points) in enumerate(named):
        path = 'M' + 'L'.join(f'{a:.1f} {b:.1f}' for a, b in (at(x, y) for x, y in points))
        out.append(f'<path d="{path}" fill="none" stroke="{colours[i % 5]}" stroke-width="2"/>')
        out.append(f'<text x="{width - 180}" y="{34 + 18 * i}" fill="{colours[i % 5]}">{name}</text>')
    out.append(f'<text x="{(width - 190) / 2:.0f}" y="{height - 6}" text-anchor="middle">{x_title}</text><text x="50" y="14">{y_title}</text></svg>')
    return '\n'.join(out) + '\n'


def curve_plot(curve):
    """Error over the time that counts, log over log, medians with least to largest; a curve a scene."""
    clock = clock_of(curve)
    settings = [{**s, 'time': s[f'{clock}_s']} for s in curve['settings'] if s['error']['median'] and s[f'{clock}_s']['median']]
    if not settings:
        return ''
    width, height = 640, 340
    span = lambda values: (min(values), max(values)) if max(values) > min(values) else (min(values) / 2, min(values) * 2)
    x0, x1 = (math.log10(v) for v in span([s['time'][k] for s in settings for k in ('min', 'max')]))
    y0, y1 = (math.log10(v) for v in span([s['error'][k] for s in settings for k in ('min', 'max')]))
    x0, x1, y0, y1 = x0 - 0.03 * (x1 - x0), x1 + 0.03 * (x1 - x0), y0 - 0.03 * (y1 - y0), y1 + 0.08 * (y1 - y0)
    at_x = lambda v: 70 + (math.log10(v) - x0) / (x1 - x0) * (width - 110)
    at_y = lambda v: height - 50 - (math.log10(v) - y0) / (y1 - y0) * (height - 80)
    colours = ('#1f5fa8', '#c0392b', '#2e8b57', '#8e6b23', '#6c3483')
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="12">',
           f'<rect width="{width}" height="{height}" fill="white"/>']
    ticks = [m * 10.0 ** e for e in range(-6, 7) for m in (1, 2, 5)]
    for v in ticks:
        if x0 <= math.log10(v) <= x1:
            out.append(f'<path d="M{at_x(v):.1f} 30V{height - 50}" stroke="#ddd"/>'
                       f'<text x="{at_x(v):.1f}" y="{height - 34}" text-anchor="middle">{v:g}</text>')
        if y0 <= math.log10(v) <= y1:
            out.append(f'<path d="M70 {at_y(v):.1f}H{width - 40}" stroke="#ddd"/>'
                       f'<text x="64" y="{at_y(v) + 4:.1f}" text-anchor="end">{v:g}</text>')
    for i, scene in enumerate(curve['scenes']):
        own = [s for s in settings if s['scene'] in (scene, i)]
        colour = colours[i % 5]
        points = [(at_x(s['time']['median']), at_y(s['error']['median'])) for s in own]
        out.append(f'<text x="{width - 40}" y="{44 + 16 * i}" fill="{colour}" text-anchor="end">{scene}</text>')
        out.append('<path d="M' + 'L'.join(f'{a:.1f} {b:.1f}' for a, b in points) + f'" fill="none" stroke="{colour}" stroke-width="2"/>')
        for s, (a, b) in zip(own, points):
            out.append(f'<path d="M{a:.1f} {at_y(s["error"]["min"]):.1f}V{at_y(s["error"]["max"]):.1f}'
                       f'M{at_x(s["time"]["min"]):.1f} {b:.1f}H{at_x(s["time"]["max"]):.1f}" stroke="{colour}"/>'
                       f'<circle cx="{a:.1f}" cy="{b:.1f}" r="4" fill="{colour if s["pareto"] else "white"}" stroke="{colour}"/>'
                       f'<text x="{a + 6:.1f}" y="{b - 6:.1f}">{s["value"]}</text>')
    out.append(f'<text x="{width / 2:.0f}" y="{height - 12}" text-anchor="middle">{CLOCKS[clock]} seconds ({curve["what"]})</text>'
               f'<text x="10" y="18">{curve["error_text"]}</text></svg>')
    return '\n'.join(out) + '\n'


# --- README.md ----------------------------------------------------------------------------------------------

def readme_block(r):
    """The table of README.md; what is not measured says so."""
    known = lambda text: text or 'not measured'
    card = lambda runs: re.sub('NVIDIA | .*', '', runs[0]['machine']['gpu'] or '') if runs else 'GPU'
    poses = r.one('poses', 'falcon_desk')
    other = next((runs for _, variant, runs in r.of('poses', 'falcon_desk', gpu=False) if variant.endswith('perfect masks')), [])
    gpu, cpu, example = r.one('scan', 'falcon_desk', gpu=True), r.one('scan', 'falcon_desk'), r.one('scan', 'example')
    example_poses = r.one('poses', 'example')
    rows = [['images placed', known(counts(poses, 'registered')), '']]
    for title, name in (('camera rotation, median / max [°]', 'object_rot_deg'), ('camera centre, median / max, % of the object', 'object_centre_pct')):
        theirs = cell(other, f'{name}.median', f'{name}.max')
        rows.append([title, known(cell(poses, f'{name}.median', f'{name}.max')), f'COLMAP with perfect masks: {theirs}' if theirs else ''])
    theirs = time_cell(other) if other else ''
    rows.append(['photos to poses, 2 CPU cores', known(time_cell(poses) if poses else ''), f'COLMAP with perfect masks: {theirs}' if theirs else ''])
    for title, runs in ((f'one {card(gpu)} and 16 CPU cores', gpu), ('2 CPU cores, `--quality low`', cpu),
                        ('the shipped 60 photos of 400 × 400, 2 CPU cores', example)):
        surface = ', '.join(f'{label} {text}' for label, text in (
            ('masks IoU', cell(runs, 'mask_iou.mean')), ('Chamfer', cell(runs, 'chamfer_pct.value')), ('F1 at 1 %', cell(runs, 'f1_1pct.value')),
            ('Chamfer to samples', '' if cell(runs, 'chamfer_pct.value') else cell(runs, 'chamfer_sampled_pct.value')),
            ('F1', '' if cell(runs, 'f1_1pct.value') else cell(runs, 'f1_sampled_1pct.value'))) if text)
        rows.append([f'photos to mesh, {title}', known(f'{time_cell(runs)}; {surface}' if runs else ''), ''])
    rows.append(['its poses: rotation, median / max [°]', known(cell(example_poses or example, 'object_rot_deg.median', 'object_rot_deg.max')), ''])
    trained, baseline = r.one('train', 'falcon_desk', 's2gs', True), r.one('train', 'falcon_desk', 'masks', True)
    theirs = cell(baseline, 'object_psnr_db')
    rows.append([f'photos never seen, exact poses, one {card(trained)}: training, PSNR, on the rotating part',
                 known(f'{cell(trained, "train_wall_seconds")} s, {cell(trained, "psnr_db")} dB, {cell(trained, "object_psnr_db")} dB' if trained else ''),
                 f'2DGS with perfect masks: {theirs} dB' if theirs else ''])
    return '\n'.join(table(['', 's2gs', 'for comparison'], rows)[:-1])


def with_block(text, block):
    """README.md with the block between its two comments replaced."""
    if text.count(BEGIN) != 1 or text.count(END) != 1 or text.index(BEGIN) > text.index(END):
        raise ValueError(f'README.md must hold once, in this order: {BEGIN} and {END}')
    return text[:text.index(BEGIN)] + BEGIN + '\n' + block + '\n' + text[text.index(END):]


def files(all_results, output, written=None):
    """{path: text} of all that is written. `written`: results.read_curves()."""
    r = Results(all_results)
    out = {output / 'BENCHMARK.md': page(r, note_titles(output / 'tests/bench/notes'), written)}
    if written:
        out[output / CURVES_PAGE] = curves_page(written)
    for name, curve in (written or {}).items():
        if 'settings' in curve and (svg := curve_plot(curve)):
            out[output / f'tests/bench/plots/curve_{name}.svg'] = svg
    if curves(r):
        out[output / 'tests/bench/plots/train.svg'] = plot(curves(r), 'seconds of training', 'PSNR on object pixels [dB]')
    readme = output / 'README.md'
    if readme.exists():
        out[readme] = with_block(readme.read_text(), readme_block(r))
    return out


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--check', action='store_true')
    parser.add_argument('--results', default=results.RESULTS)
    parser.add_argument('--output', type=pathlib.Path, default=scenes.REPOSITORY)
    args = parser.parse_args(arguments)
    stale = []
    for path, text in files(results.read_results(args.results), args.output, results.read_curves(args.results)).items():
        if args.check:
            if not path.exists() or path.read_text() != text:
                stale.append(path)
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    for path in stale:
        print(f'{path} is not what the results say: run tests/bench/report.py')
    return 1 if stale else 0


if __name__ == '__main__':
    sys.exit(main())
