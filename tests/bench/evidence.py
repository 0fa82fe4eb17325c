#!/usr/bin/env python3
"""What each source of evidence told of the poses of scans, as one Markdown table.

usage: evidence.py SCENE=WORKSPACE[=LOG] ...

WORKSPACE has report.json, as a scan leaves it. LOG is what it printed (by default the workspace's log.txt); what stands only there is
left empty without it. A source that was asked and told nothing better is "no"; one that was not asked, because the scan has nothing for
it or others told enough, is "-".
"""
import argparse
import json
import pathlib
import re

NUMBER = r'([\d.]+(?:e-?\d+)?)'
COLUMNS = ('scan', 'path', 'verdict', 'table angle, axis [deg]', 'details that were held back', 'across the end',
           'between camera places', 'second search', 'patches [px]', 'surface', 'rim', 'placed by looks', 'equal steps', 'guessed lens')


def first(pattern, text, form='{}'):
    found = re.search(pattern, text)
    return form.format(*found.groups()) if found else '-'


def held_back(reasons):
    """Of details that no adjustment has seen, how many agree with the poses."""
    good = first(r'(\d+ % of \d+) details that were held back', reasons)
    return good if good != '-' else first(r'of (\d+) details that were held back, (\d+ %)', reasons, '{1} of {0}')


def second_search(plan):
    """By how much features that are looked for again, where things change, lower standard deviations."""
    for one in plan:
        if one['part'] == 'weak_features' and one['measured']:
            lower = first(r'standard deviations lower by (\d+) %', one['measured'], '-{} %')
            return lower if one['state'] == 'runs' else 'no'
    return '-'


def patches(log):
    """Error of patches that were held back, by keypoints' poses and by the patches' own, of the last time that they were asked."""
    told = re.findall(rf'poses by patches of the photos: .*went from {NUMBER} px to {NUMBER} px', log)
    if told:
        return '{} > {}'.format(*(f'{float(value):.3f}' for value in told[-1]))
    return 'no' if 'poses by keypoints: ' in log else '-'


def rim(log):
    if "the table's rim told its axis" in log:
        return 'yes'
    return 'no' if "about the table's rim the log-likelihood" in log else '-'


def share(sigma, name):
    """Of the variance that is a prior's."""
    value = sigma.get(name)
    if isinstance(value, list):
        value = max((v for v in value if v is not None), default=None)
    return '-' if value is None else f'{100 * value:.0f} %'


def degrees(value):
    return '-' if value is None else f'{value:.3f}'


def row(scene, report, log):
    said = report['report']
    reasons = '\n'.join(said['verdict']['reasons'])
    sigma = (said.get('geometry') or {}).get('sigma', {})
    return (scene, first(r'(?m)^path +(\w+):', log), said['verdict']['verdict'],
            f"{degrees(sigma.get('angle_median_deg'))}, {degrees(sigma.get('axis_direction_deg'))}",
            held_back(reasons),
            first(r'(\d+) matches across the end', reasons), first(r'(\d+ % of \d+) matches between', reasons),
            second_search(said['stages']['plan']), patches(log),
            'yes' if 'surface between keypoints tells better' in log else 'no' if 'surface between keypoints' in log else '-',
            rim(log), first(r'(\d+ of \d+) missing photos placed by what', log), share(sigma, 'angle_prior_share'),
            share(sigma, 'focal_prior_share'))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('scans', nargs='+', metavar='SCENE=WORKSPACE[=LOG]')
    options = parser.parse_args()
    print('| ' + ' | '.join(COLUMNS) + ' |\n|' + '---|' * len(COLUMNS))
    for scan in options.scans:
        scene, *paths = scan.split('=')
        if not paths:
            parser.error(f'{scan}: SCENE=WORKSPACE is wanted')
        workspace = pathlib.Path(paths[0])
        log = pathlib.Path(paths[1]) if len(paths) > 1 else workspace / 'log.txt'
        report = json.loads((workspace / 'report.json').read_text())
        if 'report' not in report:
            parser.error(f"{workspace / 'report.json'} has no report: run s2gs report --workspace_path {workspace}")
        print('| ' + ' | '.join(row(scene, report, log.read_text() if log.exists() else '')) + ' |')


if __name__ == '__main__':
    main()
