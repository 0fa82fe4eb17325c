#!/usr/bin/env python3
"""What scans leave out, from their plan.json, as one page: results/plans.md.

usage: plans.py --commit HASH [--output FILE] SCENE=WORKSPACE[=LOG] ...

WORKSPACE has s2gs/plan.json, as `s2gs scan_planner` or a scan leaves it. LOG is the log.jsonl of a training (by default
the workspace's own): what only training decides is taken from it, the last decision on each part.
"""
import argparse
import json
import pathlib
import sys

import results

STATES = {'left out': 'left out', 'runs': 'runs', 'later': 'not decided'}


def training_decisions(log):
    """{part: decision} of a training's log."""
    events = [json.loads(line) for line in log.read_text().splitlines() if line.strip()] if log.exists() else []
    return {event['part']: event for event in events if event.get('event') == 'decision'}


def decisions(workspace, log=None):
    """Of plan.json, those that were to be decided by training with what it decided."""
    plan = json.loads((workspace / 's2gs' / 'plan.json').read_text())['decisions']
    trained = training_decisions(log or workspace / 's2gs' / 'log.jsonl')
    found = []
    for one in plan:
        if one['state'] == 'later' and one['part'] in trained:
            event = trained[one['part']]
            one = {**one, **{key: event.get(key, '') for key in ('measured', 'threshold', 'reason', 'saving')},
                   'state': 'left out' if event['left_out'] else 'runs'}
        found.append(one)
    return found


def reason(one):
    """With why nothing could force what is left out, where nothing could."""
    never = one.get('never_forced', '') if one['state'] == 'left out' else ''
    return '; '.join(text for text in (one['reason'], f'nothing to force: {never}' if never else '') if text)


def cell(text):
    return text.replace('|', '/').replace('\n', ' ')


def page(commit, scenes):
    """`scenes`: {name: decisions}."""
    lines = ['# What scans leave out', '',
             f'Made by `s2gs scan_planner` and `tests/bench/plans.py`; {commit}. Each part that some scenes do not need, with what was '
             'measured, the threshold, the reason, and what leaving it out saves; where there is nothing to force, why. What the others would have cost and gained: '
             '[curves](curves.md#what-was-left-out-and-forced).', '']
    parts = list(dict.fromkeys(one['part'] for found in scenes.values() for one in found))
    state = {(name, one['part']): STATES[one['state']] for name, found in scenes.items() for one in found}
    what = {one['part']: one['what'] for found in scenes.values() for one in found}
    lines += ['| part | ' + ' | '.join(scenes) + ' |', '|---' * (len(scenes) + 1) + '|']
    lines += [f'| `{part}`: {cell(what[part])} | ' + ' | '.join(state.get((name, part), '') for name in scenes) + ' |' for part in parts]
    scenes = {name: [{**one, 'reason': reason(one)} for one in found] for name, found in scenes.items()}
    for name, found in scenes.items():
        lines += ['', f'## {name}', '', '| part | | measured | threshold | reason | saves |', '|---|---|---|---|---|---|']
        lines += [f'| `{one["part"]}` | {STATES[one["state"]]} | ' +
                  ' | '.join(cell(one[key]) for key in ('measured', 'threshold', 'reason', 'saving')) + ' |'
                  for wanted in ('left out', 'runs', 'later') for one in found if one['state'] == wanted]
    return '\n'.join(lines) + '\n'


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('scenes', nargs='+')
    parser.add_argument('--commit', required=True)
    parser.add_argument('--output', type=pathlib.Path, default=results.RESULTS / 'plans.md')
    args = parser.parse_args(arguments)
    scenes = {}
    for text in args.scenes:
        name, *paths = text.split('=')
        if not 1 <= len(paths) <= 2:
            parser.error(f'{text} is not SCENE=WORKSPACE or SCENE=WORKSPACE=LOG')
        scenes[name] = decisions(*map(pathlib.Path, paths))
    args.output.write_text(page(args.commit, scenes))
    return 0


if __name__ == '__main__':
    sys.exit(main())
