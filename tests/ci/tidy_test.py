#!/usr/bin/env python3
"""Tests .ci/tidy on a repository of two files, with scripts in place of clang++ and clang-tidy."""
import os
import pathlib
import stat
import subprocess
import sys
import tempfile
import unittest

TIDY = pathlib.Path(__file__).resolve().parents[2] / '.ci/tidy'


class TidyTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.base = pathlib.Path(folder.name)
        self.root = self.base / 'repository'
        self.write_repository(self.root)
        self.log = self.base / 'log'
        # A preprocessor that includes one header, and a check that faults on a word; both note what they read.
        self.script('clang', 'for last; do :; done; cat "$last" "$(dirname "$last")/shared.h"')
        self.script('clang-tidy', f'''[ "$1" = --version ] && echo "version $(cat {self.base}/version)" && exit 0
for last; do :; done
echo "$last" >> {self.log}
if grep -q BAD "$last"; then echo "$last: warning"; exit 1; fi''')
        (self.base / 'version').write_text('14')

    def write_repository(self, root):
        (root / 'mesh').mkdir(parents=True)
        (root / '.ci').mkdir()
        (root / '.clang-tidy').write_text('Checks: x')
        (root / 'mesh/a.cc').write_text('int a;')
        (root / 'mesh/b.cc').write_text('int b;')
        (root / 'mesh/shared.h').write_text('int shared;')
        (root / 'build').mkdir()
        (root / '.gitignore').write_text('/build\n')
        # b.cc is not compiled here: it is read with a.cc's options.
        (root / 'build/compile_commands.json').write_text(
            f'[{{"directory": "{root}/build", "command": "g++ -I{root} -O2 -o a.o -c ../mesh/a.cc", "file": "../mesh/a.cc"}}]')
        for command in (['init', '-q'], ['add', '-A'], ['-c', 'user.name=x', '-c', 'user.email=x', 'commit', '-q', '-m', 'x']):
            subprocess.run(['git', *command], cwd=root, check=True)

    def script(self, name, text):
        path = self.base / name
        path.write_text('#!/bin/bash\n' + text + '\n')
        path.chmod(path.stat().st_mode | stat.S_IEXEC)

    def tidy(self, *arguments, root=None):
        """(exit code, what was printed, files that were looked at)"""
        self.log.unlink(missing_ok=True)
        done = subprocess.run([sys.executable, '-B', TIDY, '--root', root or self.root, '--build', 'build', '--clang', self.base / 'clang',
                               '--clang_tidy', self.base / 'clang-tidy', *arguments], capture_output=True, text=True,
                              env={**os.environ, 'XDG_CACHE_HOME': str(self.base / 'cache')})
        self.assertEqual(done.stderr, '')
        return done.returncode, done.stdout, sorted(self.log.read_text().split()) if self.log.exists() else []

    def test_looks_at_what_is_new_and_knows_it_then(self):
        self.assertEqual(self.tidy()[::2], (0, ['mesh/a.cc', 'mesh/b.cc']))
        self.assertEqual(self.tidy()[::2], (0, []))
        (self.root / 'mesh/b.cc').write_text('int c;')
        self.assertEqual(self.tidy()[::2], (0, ['mesh/b.cc']))

    def test_headers_checks_and_version_count(self):
        both = ['mesh/a.cc', 'mesh/b.cc']
        self.tidy()
        for path, text in (('repository/mesh/shared.h', 'int other;'), ('repository/.clang-tidy', 'Checks: y'), ('version', '15')):
            (self.base / path).write_text(text)
            self.assertEqual(self.tidy()[::2], (0, both), path)
            self.assertEqual(self.tidy()[::2], (0, []), path)

    def test_another_checkout_knows_too(self):
        self.tidy()
        other = self.base / 'elsewhere/checkout'
        self.write_repository(other)
        self.assertEqual(self.tidy(root=other)[::2], (0, []))

    def test_a_machine_without_a_cache_takes_what_the_repository_carries(self):
        self.assertEqual(self.tidy('--record')[0], 0)
        subprocess.run(['rm', '-r', self.base / 'cache'], check=True)
        self.assertEqual(self.tidy()[::2], (0, []))
        (self.root / 'mesh/b.cc').write_text('BAD')
        self.assertEqual(self.tidy()[::2], (1, ['mesh/b.cc']))

    def test_what_has_faults_is_not_recorded(self):
        (self.root / 'mesh/b.cc').write_text('BAD')
        self.assertEqual(self.tidy('--record')[0], 1)
        self.assertFalse((self.root / '.ci/tidy_verdicts').exists())

    def test_faults_fail_and_are_looked_at_again(self):
        (self.root / 'mesh/a.cc').write_text('BAD')
        for _ in range(2):
            code, said, _ = self.tidy()
            self.assertEqual(code, 1)
            self.assertIn('mesh/a.cc has faults', said)
        self.assertEqual(self.tidy()[2], ['mesh/a.cc'])

    def test_what_is_left_fails_loudly_and_is_done_next(self):
        code, said, looked = self.tidy('--until', '1')
        self.assertEqual((code, looked), (1, []))
        self.assertIn('FAILED', said)
        self.assertIn('mesh/a.cc', said)
        self.assertIn('2 left', said)
        self.assertEqual(self.tidy()[::2], (0, ['mesh/a.cc', 'mesh/b.cc']))
        self.assertEqual(self.tidy('--until', '1')[::2], (0, []))

    def test_changed_files_come_first(self):
        (self.root / 'mesh/b.cc').write_text('int c;')
        self.assertEqual(self.tidy('--jobs', '1')[0], 0)
        self.log.unlink()
        (self.root / 'mesh/b.cc').write_text('BAD')
        (self.root / 'mesh/shared.h').write_text('int third;')
        subprocess.run([sys.executable, '-B', TIDY, '--root', self.root, '--build', 'build', '--clang', self.base / 'clang',
                        '--clang_tidy', self.base / 'clang-tidy', '--jobs', '1'], stdout=subprocess.DEVNULL,
                       env={**os.environ, 'XDG_CACHE_HOME': str(self.base / 'cache')})
        self.assertEqual(self.log.read_text().split(), ['mesh/b.cc', 'mesh/a.cc'])

    def test_cuda_sources_are_named(self):
        (self.root / 'mesh/k.cu').write_text('')
        subprocess.run(['git', 'add', '-A'], cwd=self.root, check=True)
        self.assertIn('not for 1 CUDA sources, which nvcc alone reads: mesh/k.cu', self.tidy()[1])


if __name__ == '__main__':
    unittest.main()
