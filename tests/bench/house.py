#!/usr/bin/env python3
"""Counts what tells whether the house can be lived in, for one or several commits side by side.

usage: house.py [COMMIT ...] [--program S2GS] [--list]

Files a folder, long files and long functions, constants of sfm_split and those that no comment explains, lines of
BENCHMARK.md; of the working tree, too, the options that -h shows and --help lists (--program). --list names what is long or unexplained.
"""
import argparse
import collections
import pathlib
import re
import subprocess
import sys

from mutants import MODULES, code_only

MOST_FILES, MOST_LINES, MOST_FUNCTION_LINES = 40, 400, 60
NOT_FUNCTIONS = re.compile(r'^(if|for|while|switch|else|do|namespace|class|struct|enum|union|try|catch|return|extern|\}|case|const auto|auto|static const|constexpr)\b|\]\s*(\(|\{|mutable)|=\s*\{?$')


def git(*words):
    return subprocess.run(['git', *words], check=True, capture_output=True, text=True, errors='replace').stdout


def functions(text):
    """(first line, number of lines) of each function with a body, from braces: what clang-format lays out."""
    lines = [code_only(line) for line in text.split('\n')]
    out = []
    for i, line in enumerate(lines):
        if not re.search(r'[)\w>] \{$|\) (const|noexcept|override|final)+ \{$', line):
            continue
        first = i
        while first > 0 and lines[first - 1].strip() and not re.search(r'[;{}]\s*$|^\s*(public|private|protected):\s*$|^\s*$|^#',
                                                                       lines[first - 1]):
            first -= 1
        head = ' '.join(lines[k].strip() for k in range(first, i + 1))
        head = re.sub(r'^template <.*?> (?=\w)', '', head)
        if '(' not in head or NOT_FUNCTIONS.search(head):
            continue
        depth = 0
        for k in range(i, len(lines)):
            depth += lines[k].count('{') - lines[k].count('}')
            if depth <= 0:
                out.append((first + 1, k - first + 1))
                break
    # A function inside another (a class inside it) counts once.
    return out


def constants(text):
    """(line number, line) of constants, and those of them that no comment in, beside or above their group explains."""
    lines, all_of, bare = text.split('\n'), [], []
    first_of = {}  # last line of a constant: its first one
    for i, line in enumerate(lines):
        if not re.match(r'\s*(inline |static )*constexpr [^(]*\bk[A-Z]\w*\b', line):
            continue
        end = i
        while end + 1 < len(lines) and not code_only(lines[end]).rstrip().endswith(';'):
            end += 1
        first_of[end] = i
        all_of.append((i + 1, line.strip()))
        above = i - 1
        while above in first_of and not any('//' in code_line(lines[k]) for k in range(first_of[above], above + 1)):
            above = first_of[above] - 1
        if not any('//' in code_line(lines[k]) for k in range(i, end + 1)) and not (above >= 0 and lines[above].strip().startswith('//')):
            bare.append((i + 1, line.strip()))
    return all_of, bare


def code_line(line):
    """The line without the inside of its texts: `//` in one is no comment."""
    return re.sub(r'"(?:\\.|[^"\\])*"', '""', line)


def count(read, paths, is_listed):
    """{row: number}; `read` gives a path's text."""
    sources = [p for p in paths if p.endswith(('.h', '.cc', '.cu', '.cuh'))]
    product = [p for p in sources if p.split('/')[0] in MODULES]
    folders = collections.Counter(p.rpartition('/')[0] for p in product)
    worst, most = max(folders.items(), key=lambda f: f[1])
    texts = {p: read(p) for p in sources}
    long_files = [(len(texts[p].splitlines()), p) for p in sources if len(texts[p].splitlines()) > MOST_LINES]
    long_functions = [(n, f'{p}:{at}') for p in product for at, n in functions(texts[p]) if n > MOST_FUNCTION_LINES]
    named = [(p, *constants(texts[p])) for p in product if p.startswith('sfm_split/')]
    if is_listed:
        for title, rows in ((f'folders with over {MOST_FILES} files', [(n, f) for f, n in folders.items() if n > MOST_FILES]),
                            (f'files of over {MOST_LINES} lines', long_files), ('long functions', long_functions),
                            ('unexplained constants', [(at, f'{p}: {line}') for p, _, bare in named for at, line in bare])):
            print(f'\n{title}', *(f'  {n} {what}' for n, what in sorted(rows, reverse=True)), sep='\n')
    return {
        'sources of the product': len(product),
        'folders': len(folders),
        f'most files in a folder ({worst})': most,
        f'folders with over {MOST_FILES} files': sum(n > MOST_FILES for n in folders.values()),
        f'files of over {MOST_LINES} lines, tests too': len(long_files),
        f'functions of over {MOST_FUNCTION_LINES} lines': len(long_functions),
        'constants of sfm_split': sum(len(all_of) for _, all_of, _ in named),
        'of these without a comment': sum(len(bare) for _, _, bare in named),
        'lines of BENCHMARK.md': len(read('BENCHMARK.md').splitlines()) if 'BENCHMARK.md' in paths else 0,
    }


def options_shown(program):
    """{row: number}: options and lines of all commands' help."""
    listed = subprocess.run([program, 'help'], check=True, capture_output=True, text=True).stdout
    commands = [command for command in re.findall(r'^  ([a-z]\w+)  ', listed, re.M) if command != 'help']
    rows = {}
    for word in ('-h', '--help'):
        helps = [subprocess.run([program, command, word], capture_output=True, text=True).stdout for command in commands]
        options = [option for text in helps for option in re.findall(r'^  --([\w.]+) ', text, re.M) if option != 'help']
        rows |= {f'options that {word} shows, {len(commands)} commands together': len(options),
                 f'names that differ, {word}': len(set(options)),
                 f'lines of {word}, all commands together': sum(len(text.splitlines()) for text in helps)}
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('commits', nargs='*')
    parser.add_argument('--program')
    parser.add_argument('--list', action='store_true')
    args = parser.parse_args()
    for commit in args.commits or ['']:
        if commit:
            paths = git('ls-tree', '-r', '--name-only', commit).split('\n')
            figures = count(lambda path: git('show', f'{commit}:{path}'), paths, args.list)
        else:
            root = pathlib.Path(git('rev-parse', '--show-toplevel').strip())
            paths = git('-C', str(root), 'ls-files').split('\n')
            figures = count(lambda path: (root / path).read_text(errors='replace'), paths, args.list)
            if args.program:
                figures |= options_shown(args.program)
        print(f'\n{commit or "working tree"}', *(f'  {n:6d}  {name}' for name, n in figures.items()), sep='\n')
    return 0


if __name__ == '__main__':
    sys.exit(main())
