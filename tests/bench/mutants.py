#!/usr/bin/env python3
"""Breaks one line of the product at a time and shows which breaks no test notices.

usage: mutants.py --results FILE.jsonl [--count N] [--seed S] [--module NAME ...] [--file PATH ...] [--scratch FOLDER]
       mutants.py --results FILE.jsonl --report

Candidates are signs, factors, bounds, conditions and constants in the sources of plugin, sfm_split, s2gs and mesh, as
many from each module, in an order that the seed gives. Each is made in a worktree of its own (`--scratch`, a build
folder inside), only what the tests need is built, and the tests that cover the file run: first those of the folder
that mirrors it, then, where these pass, the module's others (COVERED_BY). A broken program that a test ends, or that
takes far longer, is killed; one whose object file is the same as before is equal and does not count.

Results are one JSON object a line. The same command goes on where it was stopped. --report prints the share that was
killed and the survivors with file and line.
"""
import argparse
import hashlib
import json
import os
import pathlib
import random
import re
import resource
import signal
import subprocess
import sys

MODULES = ('plugin', 'sfm_split', 's2gs', 'mesh')
# Folders of tests that reach a folder besides its own mirror, nearest first.
COVERED_BY = {
    'mesh': ['tests/mesh', 'tests/s2gs/rotating_mask_test.cc'],
    'plugin/cli': ['tests/plugin/cli', 'tests/plugin/commands/program_test.cc'],
    'plugin/stage': ['tests/plugin/stage', 'tests/plugin/commands/gaussian_commands_test.cc'],
    'plugin/report': ['tests/plugin/report', 'tests/plugin/commands/scan_evaluator_test.cc'],
    'plugin': ['tests/plugin'],
    's2gs/core': ['tests/s2gs/core', 'tests/s2gs/backend'],
    's2gs/kernel': ['tests/s2gs/kernel', 'tests/s2gs/cpu', 'tests/s2gs/backend'],
    's2gs/image': ['tests/s2gs/image', 'tests/s2gs/training_scene_test.cc'],
    's2gs/backend': ['tests/s2gs/backend', 'tests/s2gs'],
    's2gs/cpu': ['tests/s2gs/cpu', 'tests/s2gs/backend'],
    's2gs': ['tests/s2gs'],
    'sfm_split/base': ['tests/sfm_split/base', 'tests/sfm_split/scene'],
    'sfm_split/scene': ['tests/sfm_split/scene', 'tests/sfm_split/turntable/turntable_test.cc'],
    'sfm_split': ['tests/sfm_split'],
}
# A test program's bound of CPU time: this many times what it takes unbroken, and something for short ones [s].
TIME_FACTOR, TIME_FLOOR = 4, 20


def run(command, **more):
    return subprocess.run(command, check=True, capture_output=True, text=True, **more).stdout


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

class Scratch:
    """A worktree with a build folder as the preset cpu has it (ccache knows it), and the unbroken programs' times."""

    def __init__(self, repository, folder, jobs):
        self.root, self.build, self.jobs = folder / 'tree', folder / 'tree/build/cpu', jobs
        commit = run(['git', 'rev-parse', 'HEAD'], cwd=repository).strip()
        if not self.root.exists():
            folder.mkdir(parents=True, exist_ok=True)
            run(['git', 'worktree', 'add', '--detach', str(self.root), commit], cwd=repository)
        run(['git', 'checkout', '--force', '--detach', commit], cwd=self.root)
        self.commit = commit
        run(['cmake', '-S', str(self.root), '-B', str(self.build), '-G', 'Ninja', '-DCMAKE_BUILD_TYPE=Release',
             '-DS2GS_CUDA=OFF', '-DCMAKE_EXPORT_COMPILE_COMMANDS=ON'])
        commands = json.loads((self.build / 'compile_commands.json').read_text())
        self.objects = {os.path.relpath(c['file'], self.root): self.build / c['output'] for c in commands if 'output' in c}
        # Of unbroken programs: kept, as they only bound the broken ones.
        self.times_file = folder / 'times.json'
        self.times = json.loads(self.times_file.read_text()) if self.times_file.exists() else {}

    def make(self, programs, environment=None):
        """None when it builds, else the end of what was said."""
        done = subprocess.run(['cmake', '--build', str(self.build), '-j', str(self.jobs), '--target', *programs],
                              capture_output=True, text=True, env={**os.environ, **(environment or {})})
        return None if done.returncode == 0 else done.stdout[-1500:]

    def test(self, program, suites, seconds):
        """(exit code or None when it took too long, CPU seconds, name of the first test that failed)"""
        path = next(p for p in (self.build / 'tests').rglob(program) if p.is_file())
        before = resource.getrusage(resource.RUSAGE_CHILDREN)

        def limit():
            os.setsid()
            resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds) + 5))
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            resource.setrlimit(resource.RLIMIT_AS, (12 << 30, 12 << 30))
        filters = ':'.join(f'{s}.*:*/{s}.*:{s}/*' for s in suites)
        process = subprocess.Popen([str(path), f'--gtest_filter={filters}', '--gtest_fail_fast', '--gtest_brief=1'],
                                   stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors='replace',
                                   preexec_fn=limit, cwd=self.build / 'tests')
        try:
            # Wall time bounds what waits instead of computing; other work may share the machine.
            out = process.communicate(timeout=30 * seconds)[0]
            code = process.returncode
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            out, code = process.communicate()[0], None
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        if code in (-signal.SIGXCPU, -signal.SIGKILL):
            code = None
        failed = re.search(r'\[  FAILED  \] (\S+)', out)
        return code, used, failed[1].rstrip(',') if failed else ''

    def unbroken(self, program, suites):
        """CPU seconds of the unbroken program, or None when it fails as it is."""
        key = ' '.join([program, *suites])
        if key not in self.times:
            code, used, failed = self.test(program, suites, 1800)
            if code != 0:
                print(f'left out: {program} fails unbroken: {failed}', file=sys.stderr)
            self.times[key] = used if code == 0 else None
            self.times_file.write_text(json.dumps(self.times))
        return self.times[key]

    def digest(self, path):
        file = self.objects.get(path)
        return hashlib.sha256(file.read_bytes()).hexdigest() if file and file.exists() else None


def try_break(scratch, cut, tests, num_stages):
    path, number, kind, line, broken = cut
    result = {'file': path, 'line': number, 'kind': kind, 'before': line.strip(), 'after': broken.strip(),
              'commit': scratch.commit}
    stages = stages_of_tests(path, tests)[:num_stages]
    if not stages:
        return {**result, 'outcome': 'survived', 'by': 'no test covers it'}
    programs = sorted({program for stage in stages for program in stage})
    if message := scratch.make(programs):
        raise RuntimeError(f'the unbroken tree does not build: {message}')
    limits = {}
    for i, stage in enumerate(stages[:1]):
        limits.update({(i, p): scratch.unbroken(p, s) for p, s in stage.items()})
    file = scratch.root / path
    text = file.read_text()
    lines = text.split('\n')
    assert lines[number - 1] == line, f'{path}:{number} is not what was chosen'
    unbroken_object = scratch.digest(path)
    used_all, ran, outcome = 0.0, [], 'survived'
    try:
        lines[number - 1] = broken
        for i, stage in enumerate(stages):
            if i > 0:  # measured only when needed: on the unbroken tree
                file.write_text(text)
                scratch.make(sorted(stage))
                limits.update({(i, p): scratch.unbroken(p, s) for p, s in stage.items()})
            file.write_text('\n'.join(lines))
            if scratch.make(sorted(stage), {'CCACHE_READONLY': '1'}) is not None:
                outcome = 'does not compile'
                break
            if unbroken_object and scratch.digest(path) == unbroken_object:
                outcome = 'equal'
                break
            for program, suites in stage.items():
                if limits[i, program] is None:
                    continue
                code, used, failed = scratch.test(program, suites, TIME_FACTOR * limits[i, program] + TIME_FLOOR)
                used_all += used
                ran.append(program)
                if code != 0:
                    outcome = 'killed'
                    result['by'] = failed or (f'{program}: time' if code is None else f'{program}: exit code {code}')
                    break
            if outcome == 'killed':
                break
    finally:
        file.write_text(text)
    return {**result, 'outcome': outcome, 'ran': ran, 'cpu_seconds': round(used_all, 1)}


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
    parser.add_argument('--results', type=pathlib.Path, required=True)
    parser.add_argument('--report', action='store_true')
    parser.add_argument('--count', type=int, default=40)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--module', nargs='+', choices=MODULES, default=MODULES)
    parser.add_argument('--file', nargs='+', help='only these sources')
    parser.add_argument('--scratch', type=pathlib.Path, default=pathlib.Path('build/mutants'))
    parser.add_argument('--stages', type=int, default=3, choices=(1, 2, 3), help='1: the tests of its own name, 2: of its folder, too, 3: all')
    parser.add_argument('--jobs', type=int, default=os.cpu_count())
    args = parser.parse_args()
    results = read_results(args.results)
    if args.report:
        print(report(results))
        return 0
    repository = pathlib.Path(run(['git', 'rev-parse', '--show-toplevel']).strip())
    scratch = Scratch(repository, args.scratch.resolve(), args.jobs)
    files = [f for f in run(['git', 'ls-files', *args.module], cwd=scratch.root).split()
             if f.endswith(('.cc', '.h')) and (not args.file or f in args.file)]
    tests = test_programs(scratch.root)
    done = {key_of(r) for r in results}
    args.results.parent.mkdir(parents=True, exist_ok=True)
    chosen = choose(scratch.root, files, args.module, args.seed, args.count)
    for i, cut in enumerate(chosen):
        if (cut[0], cut[1], cut[3].strip(), cut[4].strip()) in done:
            continue
        result = try_break(scratch, cut, tests, args.stages)
        with args.results.open('a') as out:
            out.write(json.dumps(result) + '\n')
        print(f'{i + 1} of {len(chosen)}: {result["outcome"]} {result["file"]}:{result["line"]} {result["kind"]} '
              f'{result.get("by", "")}', flush=True)
    print(report(read_results(args.results)))
    return 0


if __name__ == '__main__':
    sys.exit(main())
