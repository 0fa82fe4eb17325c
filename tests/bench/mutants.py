#!/usr/bin/env python3
"""Breaks one line of the product at a time and shows which breaks no test notices.

usage: mutants.py --results FILE.jsonl [--count N] [--from I] [--to J] [--seed S] [--module NAME ...] [--file PATH ...]
       mutants.py --results FILE.jsonl --again EARLIER.jsonl ... [--file PATH ...]
       mutants.py --results FILE.jsonl --report
       mutants.py --describe FILE.json [--build FOLDER]

Candidates are signs, factors, bounds, conditions and constants in the sources of plugin, sfm_split, s2gs and mesh, as
many from each module, in an order that the seed gives. Each is made in a folder of its own beside a tree that is built
(the preset cpu, all targets), `--jobs` at a time: what depends on the file is compiled, the tests that cover it are linked
and run: first the one of its name, then those of the folder that mirrors it, then the module's others (COVERED_BY). A
broken program that a test ends, or that takes far longer, is killed; one whose objects are the same as unbroken is equal
and does not count; one that outlasts `--seconds` is not judged. They are judged in the draw's order.

Results are one JSON object a line. The same command goes on where it was stopped. --report prints the share that was
killed and the survivors with file and line. --again tries what survived in earlier results, each found by its text. --describe writes how the tree is built, so that sources, objects and
libraries can be carried to another machine (--description there, --root and --build say where they lie).
"""
import argparse
import concurrent.futures
import hashlib
import json
import os
import pathlib
import random
import re
import shutil
import signal
import subprocess
import sys
import threading
import time

import mutant_build

MODULES = ('plugin', 'sfm_split', 's2gs', 'mesh')
# Folders of tests that reach a folder besides its own mirror, nearest first.
COVERED_BY = {
    'mesh': ['tests/mesh', 'tests/s2gs/rotating_mask_test.cc', 'tests/plugin/outputs/texture_workspace_test.cc',
             'tests/plugin/commands/gaussian_commands_test.cc', 'tests/plugin/commands/table_workspace_test.cc'],
    'plugin/cli': ['tests/plugin/cli', 'tests/plugin/commands/program_test.cc'],
    'plugin/stage': ['tests/plugin/stage', 'tests/plugin/commands/gaussian_commands_test.cc'],
    'plugin/report': ['tests/plugin/report', 'tests/plugin/commands/scan_evaluator_test.cc'],
    'plugin': ['tests/plugin'],
    's2gs/core': ['tests/s2gs/core', 'tests/s2gs/backend'],
    's2gs/kernel': ['tests/s2gs/kernel', 'tests/s2gs/cpu', 'tests/s2gs/backend'],
    's2gs/image': ['tests/s2gs/image', 'tests/s2gs/scene/training_scene_test.cc'],
    's2gs/backend': ['tests/s2gs/backend', 'tests/s2gs'],
    's2gs/cpu': ['tests/s2gs/cpu', 'tests/s2gs/backend'],
    's2gs': ['tests/s2gs', 'tests/plugin/commands/gaussian_commands_test.cc', 'tests/plugin/commands/table_workspace_test.cc'],
    'sfm_split/base': ['tests/sfm_split/base', 'tests/sfm_split/scene'],
    'sfm_split/scene': ['tests/sfm_split/scene', 'tests/sfm_split/turntable/turntable_test.cc'],
    'sfm_split': ['tests/sfm_split'],
}
# A test's bound of CPU time: this many times what it takes unbroken, and something for short ones [s].
TIME_FACTOR, TIME_FLOOR = 4, 20


# --- What to break ------------------------------------------------------------------------------------------

def code_only(line):
    """The line with comments and the inside of strings blanked out, of the same length."""
    line = re.sub(r'"(?:\\.|[^"\\])*"|\'(?:\\.|[^\'\\])\'', lambda m: m[0][0] + ' ' * (len(m[0]) - 2) + m[0][-1], line)
    return re.sub(r'//.*', lambda m: ' ' * len(m[0]), line)


# Binary operators stand between spaces (clang-format), templates do not.
SWAPS = [('sign', r'(?<=\S) \+ (?=\S)', ' - '), ('sign', r'(?<=\S) - (?=\S)', ' + '), ('sign', r' \+= ', ' -= '),
         ('sign', r' -= ', ' += '), ('sign', r'(?<=[=(,] )-(?=[\w(])|(?<=return )-(?=[\w(])|(?<=\()-(?=[a-z])', ''),
         ('factor', r'(?<=\S) \* (?=\S)', ' / '), ('factor', r' / ', ' * '), ('factor', r' \*= ', ' /= '),
         ('bound', r' < ', ' <= '), ('bound', r' <= ', ' < '), ('bound', r' > ', ' >= '), ('bound', r' >= ', ' > '),
         ('bound', r' < ', ' >= '), ('bound', r' > ', ' <= '), ('bound', r' == ', ' != '), ('bound', r' != ', ' == '),
         ('condition', r' && ', ' || '), ('condition', r' \|\| ', ' && '),
         ('condition', r'(?<=[( ])!(?=[\w(])', ''), ('condition', r'\btrue\b', 'false'), ('condition', r'\bfalse\b', 'true'),
         ('bound', r'std::min\(', 'std::max('), ('bound', r'std::max\(', 'std::min('),
         ('step', r'\b(continue|break);', ';')]
SKIPPED = re.compile(r'^\s*(#|//|static_assert|using |template|namespace|S2GS_INVARIANT|S2GS_CHECK)|\boperator\b|= (default|delete)')
NUMBER = re.compile(r'(?<![\w.\]])(\d+\.\d*(?:[eE][-+]?\d+)?|\d*\.\d+(?:[eE][-+]?\d+)?|\d+e[-+]?\d+|[2-9]\d*)(?=[fF]?[\s;,)*/+-])')


def closing_bracket(code, opening):
    """Where the bracket that opens there closes, or -1 when that is not on this line."""
    depth = 0
    for i in range(opening, len(code)):
        depth += (code[i] == '(') - (code[i] == ')')
        if depth == 0:
            return i
    return -1


def breaks_of_line(line):
    """(kind, broken line) of each way to break a line."""
    code = code_only(line)
    if SKIPPED.search(code):
        return []
    out = []
    for kind, pattern, other in SWAPS:
        for match in re.finditer(pattern, code):
            if '"' in (code[match.start() - 1], code[match.end():match.end() + 1]):
                continue  # text is joined
            out.append((kind, line[:match.start()] + other + line[match.end():]))
    for match in NUMBER.finditer(code):
        text = match[0]
        is_real = '.' in text or 'e' in text.lower()
        other = repr(2 * float(text)) if is_real else str(int(text) + 1)
        if other != text:
            out.append(('constant', line[:match.start()] + other + line[match.end():]))
    if match := re.match(r'\s*(?:\} else )?if \(', code):
        end = closing_bracket(code, match.end() - 1)
        condition = line[match.end():end]
        # A declaration in the condition stays. The condition is still compiled, so that what it names is used.
        if end > 0 and not re.search(r'; | = ', condition):
            for value in ('&& false', '|| true'):
                out.append(('condition', f'{line[:match.end()]}({condition}) {value}{line[end:]}'))
    return out


def breaks_of_text(text):
    """(line number, kind, line, broken line) of all breaks of a file."""
    out, in_comment = [], False
    for number, line in enumerate(text.split('\n'), 1):
        if in_comment or line.lstrip().startswith('/*'):
            in_comment = '*/' not in line
            continue
        out += [(number, kind, line, broken) for kind, broken in breaks_of_line(line)]
    return out


def choose(root, files, modules, seed, count):
    """`count` breaks in the seed's order, as many from each module; in a module each file's share is by its breaks."""
    rng, chosen, pools = random.Random(seed), [], []
    for module in modules:
        pool = [(path, *cut) for path in files if path.split('/')[0] == module
                for cut in breaks_of_text((root / path).read_text())]
        rng.shuffle(pool)
        pools.append(pool)
    while len(chosen) < count and any(pools):
        for pool in pools:
            if pool and len(chosen) < count:
                chosen.append(pool.pop())
    return chosen


def survivors_again(root, results):
    """The breaks that survived, where the lines now stand; lines that are gone, or stand there twice, are left out."""
    chosen = []
    for r in results:
        path = root / r['file']
        if r['outcome'] != 'survived' or not path.exists():
            continue
        found = [cut for cut in breaks_of_text(path.read_text()) if (cut[2].strip(), cut[3].strip()) == (r['before'], r['after'])]
        if len(found) == 1:
            chosen.append((r['file'], *found[0]))
    return chosen


# --- Which tests cover it -----------------------------------------------------------------------------------

def test_programs(root):
    """{test file: (program, names of its suites)} from the CMakeLists.txt of the tests."""
    out = {}
    for cmake in sorted((root / 'tests').rglob('CMakeLists.txt')):
        for name, sources in re.findall(r's2gs_test\(\s*(\w+)\s+SOURCES(.*?)(?:\bLINK\b|\))', cmake.read_text(), re.S):
            for source in re.findall(r'([\w/.$<>:{}]*?)([\w/]+_test\.cc)', sources):
                path = cmake.parent / source[1]
                if path.exists():
                    suites = set(re.findall(r'^(?:TYPED_)?TEST(?:_[FP])?\((\w+)', path.read_text(), re.M))
                    out[path.relative_to(root).as_posix()] = (name, sorted(suites))
    return out


def stages_of_tests(path, tests):
    """[{program: suites}] that cover a file: one of its name, its mirrored folder, then what COVERED_BY says."""
    folder = path.rsplit('/', 1)[0]
    own = f'tests/{path.rsplit(".", 1)[0]}_test.cc'
    prefixes = [[own], [f'tests/{folder}/']]
    key = folder
    while key and key not in COVERED_BY:
        key = key.rpartition('/')[0]
    prefixes.append(COVERED_BY.get(key, []))
    stages, seen = [], set()
    for group in prefixes:
        stage = {}
        for prefix in group:
            for test, (program, suites) in tests.items():
                direct = prefix.endswith('/') and test.rsplit('/', 1)[0] + '/' == prefix
                if test not in seen and (direct or test == prefix or
                                         not prefix.endswith('/') and test.startswith(prefix + '/')):
                    seen.add(test)
                    stage.setdefault(program, []).extend(suites)
        if stage:
            stages.append(stage)
    return stages


# --- Building and running -----------------------------------------------------------------------------------

class OutOfTime(Exception):
    pass


class Stopped(Exception):
    """Another part of the same tests has failed."""


def run_tests(program, test_filter, folder, cpu_seconds, until, more=(), stop=None):
    """(exit code or None when it took too long, seconds, the test that failed or was under way at the end); in a folder of its own.

    The event `stop` ends it: Stopped."""
    folder.mkdir(parents=True, exist_ok=True)
    # The shell's limits bound a test that computes; wall time bounds one that waits.
    command = ['/bin/bash', '-c', 'ulimit -c 0; ulimit -v $((16 << 20)); ulimit -t $0; exec "$@"', str(int(cpu_seconds) + 1),
               str(program), f'--gtest_filter={test_filter}', *more]
    # Threads that wait leave the core to other breaks.
    environment = {**os.environ, 'TMPDIR': str(folder), 'TEST_TMPDIR': str(folder), 'OMP_NUM_THREADS': '2', 'OMP_WAIT_POLICY': 'passive'}
    began = time.monotonic()
    log = folder / 'log'
    end = began + max(1, min(6 * cpu_seconds + 30, until - began))
    try:
        with log.open('wb') as to:
            process = subprocess.Popen(command, stdout=to, stderr=subprocess.STDOUT, cwd=folder, env=environment, start_new_session=True)
        code = None
        while time.monotonic() < end and not (stop and stop.is_set()):
            try:
                code = process.wait(.5)
                break
            except subprocess.TimeoutExpired:
                pass
        else:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            if stop and stop.is_set():
                raise Stopped
            if time.monotonic() >= until:
                raise OutOfTime
        out = log.read_text(errors='replace')
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    if code in (-signal.SIGXCPU, -signal.SIGKILL):
        code = None
    if code == 127:
        raise RuntimeError(f'{program} does not start: {out[-500:]}')
    failed = re.search(r'^\[  FAILED  \] ([\w/.]+)', out, re.M)
    begun = re.findall(r'^\[ RUN      \] ([\w/.]+)', out, re.M)
    return code, time.monotonic() - began, failed[1] if failed else begun[-1] if begun else ''


class Unbroken:
    """Test programs as they are. A test that fails there, too, says nothing of a break."""

    def __init__(self, tree, work):
        self.tree, self.work, self.lock = tree, work, threading.Lock()
        self.locks, self.programs, self.tests = {}, {}, {}

    def lock_of(self, key):
        with self.lock:
            return self.locks.setdefault(key, threading.Lock())

    def program(self, name):
        with self.lock_of(name):
            if name not in self.programs:
                out = self.work / 'unbroken' / name
                if message := self.tree.link(f'tests/{name}', {}, out):
                    raise RuntimeError(f'{name} does not link unbroken: {message[:500]}')
                self.programs[name] = out
            return self.programs[name]

    def seconds(self, name, test, most, until):
        """What a test takes, or None when it fails or takes more than `most`."""
        program = self.program(name)
        with self.lock_of((name, test)):
            if (name, test) not in self.tests:
                code, used, _ = run_tests(program, test, self.work / 'unbroken' / f'{name}.{test}'.replace('/', '.'), most, until)
                self.tests[name, test] = used if code == 0 else None
                if code != 0:
                    print(f'left out, fails unbroken: {name} {test} (exit code {code})', flush=True)
            return self.tests[name, test]


def killer(unbroken, name, program, suites, work, most, until, shards):
    """What ends the broken program, or None when all tests of these suites pass as unbroken ones do."""
    stop, shards = threading.Event(), min(shards, len(suites))

    def part(index):
        found = killer_of_part(unbroken, name, program, suites[index::shards], work / f'run{index}', most, until, stop)
        if found:
            stop.set()
        return found

    found, errors = [], []
    with concurrent.futures.ThreadPoolExecutor(shards) as pool:
        for future in [pool.submit(part, i) for i in range(shards)]:
            try:
                found.append(future.result())
            except Stopped:
                pass
            except (OutOfTime, RuntimeError) as error:
                errors.append(error)
    by = next((f for f in found if f), None)
    if errors and not by:
        raise errors[0]
    return by


def killer_of_part(unbroken, name, program, suites, folder, most, until, stop):
    """What ends one part of the broken program's tests, or None when all of them pass as unbroken ones do."""
    left_out = []
    while True:
        test_filter = ':'.join(f'{s}.*:*/{s}.*:{s}/*' for s in suites) + ('-' + ':'.join(left_out) if left_out else '')
        code, _, test = run_tests(program, test_filter, folder, most, until, ['--gtest_fail_fast'], stop)
        if code == 0:
            return None
        if not test:
            raise RuntimeError(f'{name} ends with {code} and names no test')
        seconds = unbroken.seconds(name, test, most, until)
        if code is None and seconds is not None:
            # The bound is of all tests together: the one under way at its end is tried alone.
            code, _, _ = run_tests(program, test, folder, TIME_FACTOR * seconds + TIME_FLOOR, until, stop=stop)
            if code == 0:
                raise RuntimeError(f'the tests of {name} take more than {most} s')
            return f'{test}: time' if code is None else test
        if seconds is not None:
            return test
        left_out.append(test)


def make_program(tree, name, objects, work, until):
    """(test program, message): with the broken objects; where it starts the product's program, with a broken one of these."""
    target, replaced = f'tests/{name}', dict(objects)
    starts = [o for o in tree.links[target] if o in tree.objects and any('S2GS_PROGRAM' in w for w in tree.objects[o]['words'])
              and 'S2GS_PROGRAM' in (tree.root / tree.objects[o]['file']).read_text()]
    if starts:
        if message := tree.link('s2gs', replaced, work / 's2gs'):
            return None, message
        for o in starts:
            words = tree.objects[o]['words']
            tree.objects[f'{work.name} {o}'] = {**tree.objects[o], 'words': [
                re.sub(r'(-DS2GS_PROGRAM=)(\S*?)"[^"]*s2gs(\S*)"', lambda m: f'{m[1]}{m[2]}"{work}/s2gs{m[3]}"', w) for w in words]}
            out = work / 'objects' / f'program_{pathlib.Path(o).name}'
            if message := tree.compile(f'{work.name} {o}', work / 'overlay', out, until - time.monotonic()):
                return None, message
            del tree.objects[f'{work.name} {o}']
            replaced[o] = out
    message = tree.link(target, {o: f for o, f in replaced.items() if o in tree.links[target]
                                 or mutant_build.archive_of(o) in tree.links[target]}, work / name)
    return work / name, message


def is_equal(tree, objects, work, path, until):
    """Whether the compiler makes the same of the unbroken file."""
    shutil.copyfile(tree.root / path, work / 'overlay' / path)
    for name, broken in objects.items():
        unbroken = work / 'objects' / 'unbroken.o'
        if tree.compile(name, work / 'overlay', unbroken, until - time.monotonic()) is not None:
            return False
        if hashlib.sha256(unbroken.read_bytes()).digest() != hashlib.sha256(broken.read_bytes()).digest():
            return False
    return True


def judge(tree, unbroken, cut, tests, args, work, until):
    """{outcome, by, ran} of one break."""
    path, number, _, line, broken = cut
    lines = (tree.root / path).read_text().split('\n')
    assert lines[number - 1] == line, f'{path}:{number} is not what was chosen'
    lines[number - 1] = broken
    (work / 'overlay' / path).parent.mkdir(parents=True, exist_ok=True)
    (work / 'overlay' / path).write_text('\n'.join(lines))
    objects, ran = {}, []
    for stage in stages_of_tests(path, tests)[:args.stages]:
        for name, suites in stage.items():
            needed = set(tree.objects_of(path, f'tests/{name}'))
            if any('S2GS_PROGRAM' in w for o in tree.links[f'tests/{name}'] if o in tree.objects for w in tree.objects[o]['words']):
                needed |= set(tree.objects_of(path, 's2gs'))
            if not needed:
                continue
            for o in sorted(needed - set(objects)):
                out = work / 'objects' / f'{len(objects)}.o'
                if message := tree.compile(o, work / 'overlay', out, until - time.monotonic()):
                    return {'outcome': 'does not compile', 'by': message[:300], 'ran': ran}
                objects[o] = out
            program, message = make_program(tree, name, objects, work, until)
            if message:
                return {'outcome': 'not judged', 'by': f'does not link: {message[:500]}', 'ran': ran}
            ran.append(name)
            by = killer(unbroken, name, program, suites, work, args.test_seconds, until, args.shards)
            program.unlink()
            if by:
                return {'outcome': 'killed', 'by': by, 'ran': ran}
    if not ran:
        return {'outcome': 'survived', 'by': 'no test covers it', 'ran': ran}
    return {'outcome': 'equal' if is_equal(tree, objects, work, path, until) else 'survived', 'ran': ran}


def try_break(tree, unbroken, index, cut, tests, args):
    path, number, kind, line, broken = cut
    result = {'index': index, 'file': path, 'line': number, 'kind': kind, 'before': line.strip(), 'after': broken.strip(),
              'commit': tree.commit}
    work, began = args.work.resolve() / f'm{index}', time.monotonic()
    shutil.rmtree(work, ignore_errors=True)
    try:
        until = min(began + args.seconds, args.until)
        if until - began < 20:
            raise OutOfTime
        found = judge(tree, unbroken, cut, tests, args, work, until)
    except (OutOfTime, subprocess.TimeoutExpired):
        found = {'outcome': 'not judged', 'by': 'out of time'}
    except (RuntimeError, ValueError) as error:  # what does not link or start; a timeout that is already negative
        found = {'outcome': 'not judged', 'by': str(error)}
    finally:
        shutil.rmtree(work, ignore_errors=True)
    return {**result, **found, 'seconds': round(time.monotonic() - began, 1)}


def read_results(path):
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def key_of(result):
    return result['file'], result['line'], result['before'], result['after']


def report(results):
    lines = []
    for module in (*MODULES, ''):
        own = [r for r in results if r['file'].startswith(module)]
        killed = sum(r['outcome'] == 'killed' for r in own)
        count = killed + sum(r['outcome'] == 'survived' for r in own)
        if count:
            lines.append(f'{module or "all":10s} {killed} of {count} killed ({100 * killed / count:.0f} %)')
    for r in sorted((r for r in results if r['outcome'] == 'survived'), key=key_of):
        lines.append(f'{r["file"]}:{r["line"]}: {r["kind"]}\n    {r["before"]}\n  > {r["after"]}'
                     + (f'\n    {r["why"]}' if 'why' in r else ''))
    return '\n'.join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--results', type=pathlib.Path)
    parser.add_argument('--report', action='store_true')
    parser.add_argument('--describe', type=pathlib.Path, help='write how the tree is built, and nothing else')
    parser.add_argument('--description', type=pathlib.Path, help='as --describe wrote it; else the tree is asked')
    parser.add_argument('--root', type=pathlib.Path, default=pathlib.Path(__file__).resolve().parents[2])
    parser.add_argument('--build', type=pathlib.Path, help='build folder of the preset cpu (default: ROOT/build/cpu)')
    parser.add_argument('--work', type=pathlib.Path, default=pathlib.Path('build/mutants'), help='for broken files and programs')
    parser.add_argument('--count', type=int, default=40)
    parser.add_argument('--from', type=int, default=0, dest='first', help='index of the first of the draw to run')
    parser.add_argument('--to', type=int, help='index after the last to run')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--again', type=pathlib.Path, nargs='+', help='what survived in these results in place of a draw')
    parser.add_argument('--module', nargs='+', choices=MODULES, default=MODULES)
    parser.add_argument('--file', nargs='+', help='only these sources')
    parser.add_argument('--stages', type=int, default=3, choices=(1, 2, 3), help='1: the tests of its own name, 2: of its folder, too, 3: all')
    parser.add_argument('--jobs', type=int, default=1, help='breaks at a time')
    parser.add_argument('--shards', type=int, default=1, help='programs at a time that share the tests of one break')
    parser.add_argument('--seconds', type=float, default=1800, help='of one break at most')
    parser.add_argument('--test_seconds', type=float, default=900, help='CPU time of the tests of one program at most')
    parser.add_argument('--total_seconds', type=float, default=1e9, help='no break begins, and none goes on, after this')
    args = parser.parse_args()
    args.until = time.monotonic() + args.total_seconds
    args.build = args.build or args.root / 'build/cpu'
    tests = test_programs(args.root)
    if args.describe or not (args.description or args.report):
        programs = ['s2gs', *(f'tests/{name}' for name in sorted({program for program, _ in tests.values()}))]
        description = mutant_build.describe(args.root, args.build, programs)
    if args.describe:
        args.describe.write_text(json.dumps(description))
        return 0
    if not args.results:
        parser.error('--results is needed')
    results = read_results(args.results)
    if args.report:
        print(report(results))
        return 0
    if args.description:
        description = json.loads(args.description.read_text())
    tree = mutant_build.BuiltTree(args.root, args.build, description)
    files = sorted({path for o in tree.objects.values() for path in [o['file'], *o['deps']]
                    if path.split('/')[0] in args.module and path.endswith(('.cc', '.h')) and (not args.file or path in args.file)})
    done = {key_of(r) for r in results if r['outcome'] != 'not judged'}
    args.results.parent.mkdir(parents=True, exist_ok=True)
    if args.again:
        cuts = survivors_again(args.root, [r for path in args.again for r in read_results(path) if r['file'] in files])
    else:
        cuts = choose(args.root, files, args.module, args.seed, args.count)
    chosen = list(enumerate(cuts))[args.first:args.to]
    todo = [(i, cut) for i, cut in chosen if (cut[0], cut[1], cut[3].strip(), cut[4].strip()) not in done]
    # In the draw's order, so that what was judged when time ran out is a draw, too.
    unbroken = Unbroken(tree, args.work.resolve())
    with concurrent.futures.ThreadPoolExecutor(args.jobs) as pool:
        for future in concurrent.futures.as_completed([pool.submit(try_break, tree, unbroken, i, cut, tests, args) for i, cut in todo]):
            result = future.result()
            with args.results.open('a') as out:
                out.write(json.dumps(result) + '\n')
            print(f'{result["index"]}: {result["outcome"]} {result["file"]}:{result["line"]} {result["kind"]} '
                  f'{result.get("by", "")[:200]}', flush=True)
    print(report(read_results(args.results)))
    return 0


if __name__ == '__main__':
    sys.exit(main())
