#!/usr/bin/env python3
"""Names what got worse between two sets of results.

usage: compare.py A B [--cost]

A and B are folders of results, or commits of this repository. Runs of one suite, scene, variant and machine are
compared figure by figure, over all their seeds. Worse is: a mean that moved the wrong way by more than three standard
errors of the seeds' spread and beyond A's own range; a figure or a run that is missing; a run that failed. With one
seed on either side there is no spread, and a change is listed as such. --cost also judges seconds and memory, which
mean something on a quiet machine only. Exit code 1 when something got worse.
"""
import argparse
import math
import statistics
import sys

import results

STANDARD_ERRORS = 3
COSTS = ('seconds', '_ms', '_mib')


def is_cost(figure):
    return figure.split('.')[0].endswith(COSTS)


def values(runs, figure):
    return [run['figures'][figure] for run in runs if figure in run['figures']]


def judge(a, b, sign):
    """'worse', 'better', 'same', or 'changed' where there is no spread to judge by."""
    shift = sign * (statistics.fmean(b) - statistics.fmean(a))
    if len(a) > 1 and len(b) > 1:
        error = math.sqrt(statistics.variance(a) / len(a) + statistics.variance(b) / len(b))
        beyond = statistics.fmean(b) < min(a) or statistics.fmean(b) > max(a)
        if abs(shift) <= STANDARD_ERRORS * error or not beyond:
            return 'same'
        return 'better' if shift > 0 else 'worse'
    # Repeated runs on the CPU give the same bits: what is left is the rounding of the figures' text.
    if abs(shift) <= 1e-6 * max(map(abs, [*a, *b])):
        return 'same'
    return 'changed for better' if shift > 0 else 'changed for worse'


def compare(before, after, with_cost=False):
    """(verdict, where, what) of everything that is not the same."""
    groups = {}
    for side, runs in enumerate((before, after)):
        for run in runs:
            groups.setdefault(results.key_of(run), ([], []))[side].append(run)
    out = []
    for key, (a, b) in sorted(groups.items()):
        where = ' / '.join(part for part in key if part)
        if not b:
            out.append(('worse', where, 'no longer measured'))
        if not a or not b:
            continue
        for run in b:
            if run['exit_code'] != 0:
                out.append(('worse', where, f'seed {run["seed"]}: exit code {run["exit_code"]}'))
        if {r['data_hash'] for r in a} != {r['data_hash'] for r in b}:
            out.append(('other data', where, 'the photos are not the same'))
            continue
        for figure in sorted({name for run in a + b for name in run['figures']}):
            sign = results.direction(figure)
            if sign == 0 or is_cost(figure) and not with_cost:
                continue
            old, new = values(a, figure), values(b, figure)
            if old and not new:
                out.append(('worse', where, f'{figure}: missing, was {statistics.fmean(old):.6g}'))
            elif old and new and (verdict := judge(old, new, sign)) != 'same':
                out.append((verdict, where, f'{figure}: {statistics.fmean(old):.6g} > {statistics.fmean(new):.6g} '
                                            f'({len(old)} and {len(new)} runs)'))
    return out


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('a')
    parser.add_argument('b')
    parser.add_argument('--cost', action='store_true')
    args = parser.parse_args(arguments)
    found = compare(results.read_results(args.a), results.read_results(args.b), args.cost)
    for verdict in ('worse', 'changed for worse', 'other data', 'changed for better', 'better'):
        for _, where, what in (f for f in found if f[0] == verdict):
            print(f'{verdict:19s} {where}: {what}')
    if not found:
        print('nothing changed beyond the spread')
    return 1 if any(verdict == 'worse' for verdict, _, _ in found) else 0


if __name__ == '__main__':
    sys.exit(main())
