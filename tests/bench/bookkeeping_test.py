#!/usr/bin/env python3
"""Tests of run.py, report.py, compare.py, curves.py, plans.py, evidence.py, numerics.py, method_tables.py and mutants.py on made-up results and sources. Needs the standard library only."""
import argparse
import contextlib
import io
import json
import os
import pathlib
import re
import stat
import sys
import tempfile
import unittest
import unittest.mock

sys.dont_write_bytecode = True
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import compare
import curves
import evidence
import method_tables
import mutant_build
import mutants
import numerics
import plans
import report
import results
import run
import scenes


def result(suite='poses', scene='example', variant='', seed=0, gpu=None, figures=None, **more):
    machine = {'name': 'h200' if gpu else 'cpu2', 'cpu': 'x', 'cores': 2, 'gpu': gpu}
    return {'suite': suite, 'scene': scene, 'variant': variant, 'seed': seed, 'commit': 'abcdef0123', 'machine': machine,
            'command': ['s2gs x'], 'data_hash': '1', 'recorded': 'by run.py', 'exit_code': 0, 'figures': figures or {}, **more}


def angles(*values, **more):
    return [result(seed=i, figures={'angle_deg.median': v}, **more) for i, v in enumerate(values)]


class Results(unittest.TestCase):
    def test_written_and_read_again(self):
        with tempfile.TemporaryDirectory() as folder:
            one = result(variant='a b/c', figures={'x': 1.23456789012, 'n': 3})
            path = results.write_result(folder, one)
            self.assertEqual(path.relative_to(folder).as_posix(), 'poses/example.a-b-c.0.cpu2.json')
            read = results.read_results(folder)
            self.assertEqual(read, [{**one, 'figures': {'x': 1.234568, 'n': 3.0}}])
            self.assertEqual(list(pathlib.Path(folder).rglob('*.unfinished')), [])

    def test_what_is_wrong_is_named(self):
        self.assertIsNone(results.check_result(result()))
        for broken, words in (({'recorded': 'somehow'}, 'neither'), ({'figures': {'x': 'y'}}, 'x'), ({'figures': {'b': True}}, 'b'),
                              ({'machine': {'name': 'cpu2'}}, 'gpu')):
            self.assertIn(words, results.check_result({**result(), **broken}))
        self.assertIn('command', results.check_result({k: v for k, v in result().items() if k != 'command'}))
        with tempfile.TemporaryDirectory() as folder:
            with self.assertRaises(ValueError):
                results.write_result(folder, {**result(), 'figures': {'x': None}})

    def test_what_is_better(self):
        for name, sign in (('object_rot_deg.max', -1), ('chamfer_pct.value', -1), ('chamfer_sampled_pct.value', -1),
                           ('f1_1pct.value', 1), ('f1_sampled_1pct.value', 1), ('registered.value', 1), ('psnr_db', 1),
                           ('object_psnr_db', 1), ('mask_iou.mean', 1), ('cpu_seconds', -1), ('step_frozen_ms', -1), ('peak_mib', -1),
                           ('faces.value', 0), ('count', 0), ('load', 0), ('angle_deg.median', -1)):
            self.assertEqual(results.direction(name), sign, name)


class Compare(unittest.TestCase):
    def verdicts(self, a, b, **more):
        return [(verdict, what.split(':')[0]) for verdict, _, what in compare.compare(a, b, **more)]

    def test_beyond_the_spread(self):
        before = angles(1.0, 1.1, 0.9)
        self.assertEqual(self.verdicts(before, angles(1.05, 1.0, 1.1)), [])
        self.assertEqual(self.verdicts(before, angles(1.5, 1.6, 1.4)), [('worse', 'angle_deg.median')])
        self.assertEqual(self.verdicts(before, angles(0.5, 0.6, 0.4)), [('better', 'angle_deg.median')])
        # Three standard errors, but within what seeds gave before.
        self.assertEqual(self.verdicts(angles(1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.2), angles(1.15, 1.15, 1.15)), [])
        # Beyond the range, but with a spread that says nothing.
        self.assertEqual(self.verdicts(before, angles(0.4, 2.2)), [])

    def test_one_run_each(self):
        self.assertEqual(self.verdicts(angles(1.0), angles(1.0)), [])
        self.assertEqual(self.verdicts(angles(1.0), angles(1.001)), [('changed for worse', 'angle_deg.median')])
        self.assertEqual(self.verdicts(angles(1.0), angles(0.9)), [('changed for better', 'angle_deg.median')])

    def test_missing_failed_and_other_data(self):
        self.assertEqual(self.verdicts(angles(1.0), []), [('worse', 'no longer measured')])
        self.assertEqual(self.verdicts([], angles(1.0)), [])
        self.assertEqual(self.verdicts(angles(1.0), [result(figures={'faces.value': 1})]), [('worse', 'angle_deg.median')])
        failed = [{**angles(1.0)[0], 'exit_code': 1}]
        self.assertEqual(self.verdicts(angles(1.0), failed), [('worse', 'seed 0')])
        self.assertEqual(self.verdicts(angles(1.0), angles(2.0, data_hash='2')), [('other data', 'the photos are not the same')])
        # Another machine, suite, scene or variant is another measurement.
        self.assertEqual(self.verdicts(angles(1.0), angles(1.0) + angles(9.0, gpu='NVIDIA H200') + angles(9.0, variant='x')), [])

    def test_costs_only_when_asked_for(self):
        before, after = [result(figures={'cpu_seconds': 1.0})], [result(figures={'cpu_seconds': 2.0})]
        self.assertEqual(self.verdicts(before, after), [])
        self.assertEqual(self.verdicts(before, after, with_cost=True), [('changed for worse', 'cpu_seconds')])

    def test_exit_code_and_folders(self):
        with tempfile.TemporaryDirectory() as a, tempfile.TemporaryDirectory() as b:
            for folder, values in ((a, (1.0, 1.1, 0.9)), (b, (2.0, 2.1, 1.9))):
                for one in angles(*values):
                    results.write_result(folder, one)
            out = io.StringIO()
            with contextlib.redirect_stdout(out):
                self.assertEqual(compare.main([a, b]), 1)
                self.assertEqual(compare.main([b, a]), 0)
                self.assertEqual(compare.main([a, a]), 0)
            self.assertIn('worse               poses / example / cpu2: angle_deg.median: 1 > 2 (3 and 3 runs)', out.getvalue())
            with self.assertRaises(FileNotFoundError):
                results.read_results(a + '/not there')


class Report(unittest.TestCase):
    def test_numbers(self):
        for value, text in ((0, '0'), (0.01234, '0.0123'), (0.999, '0.999'), (1.5, '1.5'), (4, '4'), (300.4, '300'), (0.0400, '0.04'), (31.46, '31.5'), (60, '60'),
                            (636773, '636,773'), (457.4, '457'), (1234.5, '1,234')):
            self.assertEqual(report.digits(value), text)

    def test_no_result_is_by_hand(self):
        self.assertEqual([r['scene'] for r in results.read_results(results.RESULTS) if r['recorded'] != 'by run.py'], [])

    def test_medians_ranges_and_marks(self):
        runs = angles(0.02, 0.04, 0.03)
        self.assertEqual(report.cell(runs, 'angle_deg.median'), '0.03 (0.02 to 0.04)')
        self.assertEqual(report.cell(runs[:1], 'angle_deg.median', 'angle_deg.max'), '')
        self.assertEqual(report.cell([result(figures={'a': 1.0, 'b': 2.0})], 'a', 'b'), '1 / 2')
        self.assertEqual(report.counts([result(figures={'registered.value': n, 'registered.of': 60}) for n in (60, 58)], 'registered'), '58 of 60')
        page = report.page(report.Results([angles(1.0)[0], {**angles(1.0, scene='box')[0], 'exit_code': 1}]), [])
        self.assertIn('| box (FAILED: 1 of 1) |', page)
        self.assertIn('Not measured yet.', page)

    def test_readme_block_is_replaced_and_checked(self):
        with tempfile.TemporaryDirectory() as folder:
            root = pathlib.Path(folder)
            (root / 'results').mkdir()
            results.write_result(root / 'results', result(scene='falcon_desk', figures={
                'registered.value': 100, 'registered.of': 100, 'object_rot_deg.median': 0.0106, 'object_rot_deg.max': 0.0338}))
            (root / 'README.md').write_text(f'before\n{report.BEGIN}\nold\n{report.END}\nafter\n')
            arguments = ['--results', str(root / 'results'), '--output', folder]
            out = io.StringIO()
            with contextlib.redirect_stdout(out):
                self.assertEqual(report.main([*arguments, '--check']), 1)
                self.assertEqual((root / 'README.md').read_text().split('\n')[2], 'old')
                self.assertEqual(report.main(arguments), 0)
                self.assertEqual(report.main([*arguments, '--check']), 0)
            text = (root / 'README.md').read_text()
            self.assertTrue(text.startswith('before\n') and text.endswith('\nafter\n') and '\nold\n' not in text)
            self.assertIn('| camera rotation, median / max [°] | 0.0106 / 0.0338 |', text)
            self.assertIn('| images placed | 100 of 100 |', text)
            self.assertIn('not measured', text)
            (root / 'README.md').write_text(text.replace('0.0106', '0.0105'))
            with contextlib.redirect_stdout(out):
                self.assertEqual(report.main([*arguments, '--check']), 1)
            with self.assertRaises(ValueError):
                report.with_block('no comments', 'x')

    def test_kernels_on_a_shared_machine_show_what_load_does_not_change(self):
        figures = {'fusion_seconds': 94.4, 'fusion_cpu_seconds': 2.9, 'step_ms': 63.4, 'cpu_seconds': 14, 'wall_seconds': 397, 'load': 5.6}
        self.assertEqual(report.kernel_names(figures, None), ['fusion_cpu_seconds', 'step_ms', 'load'])
        self.assertEqual(report.kernel_names(figures, 'a card'), ['fusion_cpu_seconds', 'fusion_seconds', 'step_ms', 'load'])

    def test_what_the_program_calls_its_poses(self):
        runs = [result(figures={'called_good': good}) for good in (1, 1, 0)]
        self.assertEqual([report.verdict_cell(some) for some in (runs[:2], runs, runs[2:], [result(figures={})])],
                         ['good', 'some doubtful', 'doubtful', ''])

    def test_plot_is_inside_its_frame(self):
        drawn = report.plot([('a', [[1, 20.0], [100, 31.5]]), ('b', [[10, 25.0]])], 's', 'dB')
        self.assertIn('M50.0 ', drawn)
        self.assertEqual(drawn.count('<path d="M50'), 7 + 1 + 1)  # 20, 22 ... 32 dB, one second, the first curve
        self.assertTrue(drawn.endswith('</svg>\n'))


class FakeProgram:
    """A program that does what s2gs's commands leave behind, and counts its calls."""

    def __init__(self, root, code=0):
        self.path, self.calls = root / 's2gs', root / 'calls'
        report_json = json.dumps({'verdict': {'verdict': 'doubtful'}, 'stages': [{'name': 'split', 'run': True, 'seconds': 1.25}, {'name': 'old', 'run': False, 'seconds': 9}]})
        figures = json.dumps({'figures': {'angle_deg': {'unit': 'degrees', 'median': 0.5, 'max': 1, 'note': 'x'}}})
        self.path.write_text(f'''#!/bin/sh
echo "$@" >> {self.calls}
workspace=$3
case $1 in
  automatic_scanner) echo '{report_json}' > $workspace/report.json; exit {code};;
  scan_evaluator) echo '{figures}' > $7;;
esac
''')
        self.path.chmod(self.path.stat().st_mode | stat.S_IEXEC)

    def count(self):
        return len(self.calls.read_text().splitlines()) if self.calls.exists() else 0


class Run(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.root = pathlib.Path(folder.name)
        for name in ('data/example/images', 'data/example/gt', 'work'):
            (self.root / name).mkdir(parents=True)
        (self.root / 'data/example/images/a.jpg').write_text('photo')
        (self.root / 'data/example/gt/scene.json').write_text('{}')

    def session(self, program, commit='1234567', python=sys.executable):
        return run.Session(argparse.Namespace(variants='', program=program.path, tools=self.root, data=self.root / 'data', work=self.root / 'work',
                                              results=self.root / 'results', gpu=False, machine='test', commit=commit, again=False,
                                              python=python))

    def suite(self, session, names=('example',), seeds=(0,)):
        out = io.StringIO()
        with contextlib.redirect_stdout(out):
            failures = run.run_suite(session, 'poses', names, seeds)
        return failures, out.getvalue()

    def test_measures_once_and_goes_on(self):
        program = FakeProgram(self.root)
        failures, out = self.suite(self.session(program))
        self.assertEqual(failures, 0)
        self.assertIn('differs from the recorded scene', out)
        self.assertEqual(program.count(), 2)
        read = results.read_results(self.root / 'results')
        self.assertEqual(len(read), 1)
        figures = read[0]['figures']
        self.assertEqual((figures['angle_deg.median'], figures['angle_deg.max'], figures['stage_seconds.split']), (0.5, 1, 1.2))
        self.assertNotIn('stage_seconds.old', figures)
        self.assertEqual(figures['called_good'], 0)
        self.assertEqual(read[0]['command'], ['s2gs automatic_scanner --workspace_path WORK/poses-example-0 --image_path '
                                              'DATA/example/images --until split --random_seed 0 --use_gpu 0'])
        self.assertEqual(read[0]['data_hash'], scenes.folder_hash(self.root / 'data/example'))
        _, out = self.suite(self.session(program), seeds=(0, 1))
        self.assertIn('done already: poses/example.0.test.json', out)
        self.assertEqual(program.count(), 4)
        # Another program, or other photos: measured again.
        self.suite(self.session(program, commit='7654321'))
        self.assertEqual(program.count(), 6)
        (self.root / 'data/example/images/a.jpg').write_text('another')
        self.suite(self.session(program, commit='7654321'))
        self.assertEqual(program.count(), 8)

    def test_failures_are_recorded_and_run_again(self):
        program = FakeProgram(self.root, code=3)
        self.assertEqual(self.suite(self.session(program))[0], 1)
        read = results.read_results(self.root / 'results')
        self.assertEqual((read[0]['exit_code'], set(read[0]['figures'])), (3, {'cpu_seconds', 'wall_seconds', 'load'}))
        FakeProgram(self.root)
        self.assertEqual(self.suite(self.session(program))[0], 0)
        self.assertEqual(results.read_results(self.root / 'results')[0]['exit_code'], 0)

    def test_a_scene_that_is_missing_is_said_loudly(self):
        session = self.session(FakeProgram(self.root), python='/no/python')
        failures, out = self.suite(session, names=('vase', 'example'))
        self.assertEqual(failures, 0)
        self.assertIn('LEFT OUT poses vase', out)
        self.assertEqual(len(session.left_out), 1)
        self.assertIn('requirements.txt', session.left_out[0])
        self.assertEqual(len(results.read_results(self.root / 'results')), 1)

    def test_a_python_is_one_that_has_what_is_needed(self):
        session = self.session(FakeProgram(self.root))
        self.assertEqual(session.python('json, os'), sys.executable)
        with self.assertRaisesRegex(FileNotFoundError, 'no Python with no_such_module'):
            session.python('no_such_module')
        # None is named: a venv is made once, with what the file beside says.
        session = self.session(FakeProgram(self.root), python=None)
        made = []
        session.made_python = lambda modules: made.append(modules) or '/made/python'
        self.assertEqual([session.python('no_such_module') for _ in range(2)], ['/made/python'] * 2)
        self.assertEqual(made, ['no_such_module'])
        listed = (scenes.HERE / 'requirements.txt').read_text()
        for package in ('numpy', 'scipy', 'open3d', 'pillow', 'opencv'):  # as run.py asks for numpy, scipy, open3d, PIL, cv2
            self.assertIn(package, listed)

    def test_a_program_that_is_missing_is_named_with_what_builds_it(self):
        args = argparse.Namespace(program=self.root / 'none', tools=None, gpu=False)
        with self.assertRaisesRegex(SystemExit, r'no program .*/none: .bash tests/run.sh.'):
            run.check_programs(args, ['poses'])
        args.program = FakeProgram(self.root).path
        run.check_programs(args, ['poses'])
        self.assertEqual(args.tools, self.root.resolve() / 'tests')
        with self.assertRaisesRegex(SystemExit, 'no tsdf_bench and no step_bench in .*/tests'):
            run.check_programs(args, ['kernels', 'poses'])

    def test_hash_of_names_and_bytes(self):
        folder = self.root / 'data/example'
        before = scenes.folder_hash(folder)
        (folder / 'notes.txt').write_text('not part of it')
        self.assertEqual(scenes.folder_hash(folder), before)
        (folder / 'images/a.jpg').rename(folder / 'images/b.jpg')
        self.assertNotEqual(scenes.folder_hash(folder), before)

    def test_training_holds_photos_out(self):
        listed = self.root / 'test_list.txt'
        self.assertEqual(run.held_out(self.root), ['--test_every', '10'])
        listed.write_text('\n')
        self.assertEqual(run.held_out(self.root), ['--test_every', '10'])
        listed.write_text('a.jpg\n')
        self.assertEqual(run.held_out(self.root), ['--test_list', listed])

    def test_training_log(self):
        log = self.root / 'log.jsonl'
        line = {'event': 'held_out', 'iteration': 10, 'count': 5, 'wall_s': 2.5, 'cpu_s': 4, 'psnr_db': 30.0, 'ssim': 0.9,
                'object_psnr_db': 28.0, 'object_ssim': None, 'mask_iou': 0.99}
        log.write_text('\n'.join(json.dumps(x) for x in ({'event': 'loss', 'iteration': 1}, {**line, 'iteration': 5, 'wall_s': 1.0}, line)))
        found = run.training_figures(log)
        source = (scenes.REPOSITORY / 's2gs/train_log.cc').read_text()
        for name in line:  # as the program writes them
            self.assertIn(f'"{name}"', source)
        self.assertEqual((found['iteration'], found['psnr_db'], found['train_wall_seconds']), (10, 30.0, 2.5))
        self.assertNotIn('object_ssim', found)
        self.assertEqual(found['curve'], [[1.0, 28.0], [2.5, 28.0]])

    def test_output_of_the_timers(self):
        self.assertEqual(run.numbers_of(r'a ([\d.]+) b (\d+)', 'x a 1.5 b 2 y', ['a', 'b']), {'a': 1.5, 'b': 2})
        with self.assertRaises(ValueError):
            run.numbers_of('a', 'b', [])

    def test_scenes_have_an_entry_each_suite_knows(self):
        known = scenes.read_scenes()
        for pair in run.SUITES.values():
            for names in pair:
                self.assertLessEqual(set(names), set(known))


class Mutants(unittest.TestCase):
    def breaks(self, line):
        return [(kind, broken.strip()) for kind, broken in mutants.breaks_of_line(line)]

    def test_one_place_at_a_time(self):
        self.assertEqual(self.breaks('  x = a + b * c;'), [('sign', 'x = a - b * c;'), ('factor', 'x = a + b / c;')])
        self.assertEqual(self.breaks('  x = -a;'), [('sign', 'x = a;')])
        self.assertEqual(self.breaks('  double x = 0.5;'), [('constant', 'double x = 1.0;')])
        self.assertIn(('bound', 'if (a <= b) return;'), self.breaks('  if (a < b) return;'))
        self.assertIn(('condition', 'if ((a < b) && false) return;'), self.breaks('  if (a < b) return;'))
        self.assertIn(('condition', 'if ((f(a)) || true) g(")");'), self.breaks('  if (f(a)) g(")");'))

    def test_what_is_no_code_stays(self):
        for line in ('// a + b', '#include <a + b>', 'static_assert(a < b);', 'out << "a + b";', 'std::vector<int> x;',
                     'template <typename T = A>', 'const int& operator+(int);', 'a = "x" + b;'):
            self.assertEqual(self.breaks(line), [], line)
        self.assertEqual(mutants.breaks_of_text('/* a + b\n a + b\n*/\nx = a + b;')[0][0], 4)

    def test_tests_of_a_file_nearest_first(self):
        tests = {'tests/mesh/surface/decimate_test.cc': ('mesh_tests', ['Decimate']), 'tests/mesh/surface/other_test.cc': ('mesh_tests', ['Other']),
                 'tests/mesh/io/files_test.cc': ('file_tests', ['Files']), 'tests/plugin/x_test.cc': ('p', ['X'])}
        self.assertEqual(mutants.stages_of_tests('mesh/surface/decimate.cc', tests),
                         [{'mesh_tests': ['Decimate']}, {'mesh_tests': ['Other']}, {'file_tests': ['Files']}])

    def test_what_a_broken_file_changes_in_a_program(self):
        words = ['c++', 'tests/CMakeFiles/p.dir/a_test.cc.o', '-o', 'tests/p', 'm/libm.a']
        tree = mutant_build.BuiltTree('/r', '/r/b', {'commit': '', 'links': {'tests/p': words}, 'objects': {
            'm/CMakeFiles/m.dir/a.cc.o': {'file': 'm/a.cc', 'words': [], 'deps': ['m/a.cc', 'm/a.h']},
            'n/CMakeFiles/n.dir/b.cc.o': {'file': 'n/b.cc', 'words': [], 'deps': ['n/b.cc', 'm/a.h']},
            'tests/CMakeFiles/p.dir/a_test.cc.o': {'file': 'tests/a_test.cc', 'words': [], 'deps': ['tests/a_test.cc', 'm/a.h']}}})
        self.assertEqual(tree.objects_of('m/a.cc', 'tests/p'), ['m/CMakeFiles/m.dir/a.cc.o'])
        self.assertEqual(tree.objects_of('m/a.h', 'tests/p'), ['m/CMakeFiles/m.dir/a.cc.o', words[1]])

    def test_the_repositorys_own_tests_are_found(self):
        found = mutants.test_programs(scenes.REPOSITORY)
        self.assertIn('Freeze', found['tests/s2gs/freeze_test.cc'][1])
        self.assertGreater(len(found), 80)

    def test_survivors_are_found_by_their_text(self):
        with tempfile.TemporaryDirectory() as folder:
            (pathlib.Path(folder) / 'a.cc').write_text('\nx = a + b;\ny = c + d;\ny = c + d;\n')
            one = {'file': 'a.cc', 'line': 9, 'before': 'x = a + b;', 'after': 'x = a - b;', 'outcome': 'survived'}
            self.assertEqual(mutants.survivors_again(pathlib.Path(folder), [
                one, {**one, 'outcome': 'killed'}, {**one, 'file': 'gone.cc'},
                {**one, 'before': 'y = c + d;', 'after': 'y = c - d;'}]), [('a.cc', 2, 'sign', 'x = a + b;', 'x = a - b;')])

    def test_report_counts(self):
        one = {'file': 'mesh/a.cc', 'line': 3, 'kind': 'sign', 'before': 'a + b', 'after': 'a - b', 'outcome': 'killed'}
        text = mutants.report([one, {**one, 'line': 4, 'outcome': 'survived'}, {**one, 'line': 5, 'outcome': 'equal'},
                               {**one, 'line': 6, 'outcome': 'does not compile'}])
        self.assertIn('mesh       1 of 2 killed (50 %)', text)
        self.assertIn('mesh/a.cc:4: sign', text)
        self.assertNotIn('mesh/a.cc:3', text)


class ExactWorkspace(unittest.TestCase):
    def test_numbers_are_written_without_their_type(self):
        class Named(float):  # as numpy 2 shows its own
            def __repr__(self):
                return f'np.float64({float(self)!r})'

        try:
            import exact_workspace
        except ModuleNotFoundError as missing:
            self.skipTest(str(missing))
        scene = {'width': 4, 'height': 3, 'fx': 5.5, 'fy': 5.5, 'cx': 2.0, 'cy': 1.5}
        with tempfile.TemporaryDirectory() as folder:
            exact_workspace.write_model(folder, scene, [], [[Named(v) for v in (0.1, -2.5, 3, 10, 20, 30)]])
            text = (pathlib.Path(folder) / 'points3D.txt').read_text()
        self.assertEqual(text, '1 0.1 -2.5 3.0 10 20 30 -1\n')

    def test_points_of_a_model_come_into_the_exact_frame(self):
        try:
            import exact_workspace
            import numpy as np
        except ModuleNotFoundError as missing:
            self.skipTest(str(missing))
        turn, shift = exact_workspace.rotation(np.array([0.8, 0.2, -0.5, 0.3])), np.array([1.0, -2.0, 0.5])
        x_in_model = np.array([[0.3, 0.1, 2.0], [-1.0, 0.4, 3.0]])
        scene = {'width': 4, 'height': 3, 'fx': 5.5, 'fy': 5.5, 'cx': 2.0, 'cy': 1.5}

        def moved(places):
            """By a model whose unit is a third of the exact one, photos from these places, two a place."""
            in_model, exact = [], []
            for i, centre in enumerate(places * 2):
                cam_from_model = exact_workspace.rotation(np.array([1.0, 0.1 * i, 0.2, 0.0]))
                in_model.append((f'{i}.jpg', np.vstack([np.column_stack([cam_from_model, -cam_from_model @ centre]), [0, 0, 0, 1]])))
                cam_from_exact, place = cam_from_model @ turn.T, 3 * turn @ centre + shift
                exact.append((f'{i}.jpg', np.vstack([np.column_stack([cam_from_exact, -cam_from_exact @ place]), [0, 0, 0, 1]])))
            with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
                exact_workspace.write_model(folder, scene, in_model, [])
                (pathlib.Path(folder) / 'points3D.txt').write_text(''.join(
                    f'{i} {" ".join(map(str, x))} 10 20 30 0.5{" 1 0" * seen}\n' for i, (x, seen) in enumerate(zip(x_in_model, (3, 2)))))
                return exact_workspace.moved_points(folder, exact)

        places = [np.array([0.0, 0.0, 0.0]), np.array([1.0, 0.5, 0.2])]
        # Nine digits of a rotation's matrix survive its way through a quaternion and a text.
        np.testing.assert_allclose(moved(places), [[*(3 * turn @ x_in_model[0] + shift), 10, 20, 30]], atol=1e-9)
        with self.assertRaises(SystemExit):
            moved(places[:1])

    def test_stations_of_an_exact_workspace_count_from_zero(self):
        try:
            import exact_workspace
        except ModuleNotFoundError as missing:
            self.skipTest(str(missing))
        unit = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
        images = [{'file': f'images/{name}.jpg', 'mask': f'gt/masks/{name}.png', 'station': station, 'angle_deg': 0, 'split': 'train',
                   'world_to_camera': unit, 'object_to_world': unit} for name, station in (('a', 1), ('b', 4), ('c', 1))]
        scene = {'width': 4, 'height': 3, 'fx': 5.5, 'fy': 5.5, 'cx': 2.0, 'cy': 1.5, 'axis_point': [0, 0, 0],
                 'axis_direction': [0, 0, 1], 'stations': [1, 4], 'images': images}
        with tempfile.TemporaryDirectory() as folder:
            (pathlib.Path(folder) / 'gt').mkdir()
            (pathlib.Path(folder) / 'gt/scene.json').write_text(json.dumps(scene))
            with contextlib.redirect_stdout(io.StringIO()), unittest.mock.patch.object(sys, 'argv', ['x', folder, folder + '/w']):
                exact_workspace.main()
            turns = json.loads((pathlib.Path(folder) / 'w/turntable.json').read_text())
        self.assertEqual([image['station'] for image in turns['images']], [0, 1, 0])


class Numerics(unittest.TestCase):
    ADAM = '| span | measured on | rate |\n| --- | --- | --- |\n'

    def build(self, folder, values, adam, exit_code=0):
        """A made-up BUILD/tests, whose backend_tests measure {on: value} against a bound of 1 in every row."""
        folder.mkdir(exist_ok=True)
        records = ''.join(json.dumps({'row': row, 'what': 'error', 'on': on, 'measured': value, 'bound': 1, 'holds': value <= 1,
                                      'test': 'A.B'}) + '\n' for row, _ in numerics.ROWS for on, value in values.items())
        outputs = {program: '' for program in numerics.PROGRAMS}
        outputs |= {'stiffness': f'# Stiff\n\n{self.ADAM}{adam}\nends', 'numerics_stress': f'0 failed on {sorted(values)}'}
        for program, text in outputs.items():
            path = folder / program
            more = f"cat >>$S2GS_NUMERICS <<'END'\n{records}END\n" if program == 'backend_tests' else ''
            path.write_text(f"#!/bin/sh\n{more}cat <<'END'\n{text}\nEND\nexit {exit_code if program == 'core_tests' else 0}\n")
            path.chmod(path.stat().st_mode | stat.S_IXUSR)
        return folder

    def measure(self, tests, results_folder, backend, commit):
        out = io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
            return numerics.main([str(tests), '--backend', backend, '--results', str(results_folder), '--commit', commit])

    def test_a_command_for_each_backend_makes_the_pages(self):
        with tempfile.TemporaryDirectory() as temporary:
            folder = pathlib.Path(temporary)
            of_cpu = self.build(folder / 'a', {'cpu': 0.25, 'double': 0.125}, '| 10 | cpu | 1 |\n| 99 | cpu | 2 |\n')
            of_gpu = self.build(folder / 'b', {'cpu': 9, 'cuda': 0.5}, '| 10 | cpu | 7 |\n| 10 | cuda | 3 |\n| 99 | cuda | 4 |\n')
            self.assertEqual(self.measure(of_cpu, folder / 'results', 'cpu', 'aaaa'), 0)
            self.assertEqual(self.measure(of_gpu, folder / 'results', 'cuda', 'bbbb'), 0)
            page = (folder / 'results/numerics.md').read_text()
            for cell in ('| cpu | error | 0.25 |', '| double | error | 0.12 |', '| cuda | error | 0.5 |'):
                self.assertEqual(page.count(cell), len(numerics.ROWS), cell)
            self.assertNotIn('| 9 |', page)  # the CPU's value on the other machine is none of --backend cuda
            self.assertRegex(page, r'`cpu`: aaaa, .*`cuda`: bbbb, ')
            rows = [line for line in (folder / 'results/stiffness.md').read_text().split('\n') if line.startswith('| 10') or line.startswith('| 99')]
            self.assertEqual(rows, ['| 10 | cpu | 1 |', '| 10 | cuda | 3 |', '| 99 | cpu | 2 |', '| 99 | cuda | 4 |'])
            stress = (folder / 'results/numerics_stress.md').read_text()
            self.assertIn("0 failed on ['cpu', 'double']", stress)
            self.assertIn("0 failed on ['cpu', 'cuda']", stress)
            # Measured again, a backend's rows replace its own alone.
            again = self.build(folder / 'c', {'cpu': 0.75}, '| 10 | cpu | 5 |\n')
            self.assertEqual(self.measure(again, folder / 'results', 'cpu', 'cccc'), 0)
            page = (folder / 'results/numerics.md').read_text()
            self.assertEqual([page.count(cell) for cell in ('| cpu | error | 0.75 |', '| double |', '| cuda | error | 0.5 |')],
                             [len(numerics.ROWS), 0, len(numerics.ROWS)])
            self.assertIn('| 10 | cpu | 5 |\n| 10 | cuda | 3 |\n| 99 | cuda | 4 |\n', (folder / 'results/stiffness.md').read_text())

    def test_what_fails_is_said(self):
        with tempfile.TemporaryDirectory() as temporary:
            folder = pathlib.Path(temporary)
            past = self.build(folder / 'a', {'cpu': 2}, '')
            self.assertEqual(self.measure(past, folder / 'r', 'cpu', 'a'), 1)
            self.assertIn('| 2 | 1 | **fails** |', (folder / 'r/numerics.md').read_text())
            ends_badly = self.build(folder / 'b', {'cpu': 1}, '', exit_code=3)
            self.assertEqual(self.measure(ends_badly, folder / 's', 'cpu', 'a'), 1)
            no_gpu = self.build(folder / 'c', {'cpu': 1}, '')
            self.assertEqual(self.measure(no_gpu, folder / 't', 'cuda', 'a'), 1)


class CurveJobs(unittest.TestCase):
    # Stands for s2gs: notes its words, begin and end; work_precision writes them as its curve, or fails where told to:
    # itself with the knob "bad", all its runs with "no_run_ends".
    PROGRAM = """#!{python}
import json, os, pathlib, sys, time
words, folder = sys.argv[1:], pathlib.Path(__file__).parent
given = dict(zip(words[1::2], words[2::2]))
note = lambda what: open(folder / 'notes', 'a').write(json.dumps([what, words, sorted(os.sched_getaffinity(0))]) + '\\n')
note('begin')
time.sleep(0.15)
if 'curves' in ' '.join(given): given['--values'] = ','.join(json.loads(pathlib.Path(p).read_text())['values'] for p in given['--curves'].split(','))
if given.get('--knob') == 'bad': sys.exit(3)
if words[0] == 'work_precision':
    points = [{{'failure': 'no memory' if given.get('--knob') == 'no_run_ends' else ''}}]
    written = {{'curves': [{{'points': points}}]}} if '--forced' in given else {{'points': points}}
    pathlib.Path(given['--output_path'] + '.json').write_text(json.dumps({{'values': given.get('--values', ''), **written}}))
note('end')
"""
    PLAN = [{'name': 'by_gpu', 'knob': 'voxel', 'scenes': ['a', 'b'], 'seeds': [0, 1], 'values': [['1', '2'], ['3', '4']], 'gpu': True,
             'arguments': ['x=1', 'y=2']},
            {'name': 'meshes', 'knob': 'refinement', 'scenes': ['a'], 'seeds': [7], 'values': [['5', '6']], 'truth': True,
             'model': {'arguments': ['quality=high']}},
            {'name': 'parts', 'forced': ['p', 'q'], 'scenes': ['a', 'b'], 'seeds': [0, 1, 2], 'cores': 2},
            {'name': 'fails', 'knob': 'bad', 'scenes': ['a'], 'seeds': [0], 'values': [['1', '2']]},
            {'name': 'nothing', 'knob': 'no_run_ends', 'scenes': ['a'], 'seeds': [0], 'values': [['1', '2']]},
            {'name': 'long', 'command': ['sleep', '60']}]

    @unittest.skipUnless(hasattr(os, 'sched_setaffinity'), 'cores cannot be dealt out here')
    def test_jobs_share_the_cores_until_the_time_is_up(self):
        with tempfile.TemporaryDirectory() as temporary:
            folder = pathlib.Path(temporary).resolve()
            program = folder / 's2gs'
            program.write_text(self.PROGRAM.format(python=sys.executable))
            program.chmod(0o755)
            for scene in 'ab':
                (folder / 'data' / scene / 'work_precision').mkdir(parents=True)
            curves.make_scans(self.PLAN, folder / 'data', folder / 'out')
            self.assertEqual(sorted(str(p.relative_to(folder / 'out/scans')) for p in (folder / 'out/scans').glob('*/*')),
                             ['by_gpu/a', 'by_gpu/b', 'fails/a', 'nothing/a', 'parts/a', 'parts/b'])
            self.assertEqual(list((folder / 'out/scans').glob('*/*/*')), [])  # runs of the scan itself stay behind
            jobs = lambda: curves.jobs_of(self.PLAN, str(program), folder / 'data', folder / 'out')
            run_them = lambda these, seconds: curves.run_jobs(these, folder / 'out', seconds, [0, 0, 0, 0], 2, tick=0.01)
            first = [job for job in jobs() if job.name != 'long']
            with contextlib.redirect_stdout(io.StringIO()):
                run_them(first, 120)
            self.assertEqual({job.name: job.state for job in first if job.state != 'done'},
                             {'fails.a.seed0.0': 'failed', 'nothing.a.seed0.0': 'failed'})
            self.assertEqual(len(first), 8 + 2 + 6 + 2)
            notes = [json.loads(line) for line in (folder / 'notes').read_text().splitlines()]
            at_once = most = 0
            for what, words, cores in notes:
                if '--knob' in words and words[words.index('--knob') + 1] == 'voxel':
                    at_once += 1 if what == 'begin' else -1
                    most = max(most, at_once)
                self.assertEqual(cores, [0])
            self.assertEqual(most, 2)  # two jobs of the GPU at a time, and never more
            order = [words[0] for what, words, _ in notes if str(curves.model_folder(folder / 'out', 'a', 7)) in words and what == 'end']
            self.assertEqual(order, ['gaussian_trainer', 'gaussian_renderer', 'work_precision'])
            # What is done is not done again, and what still runs at the end is cut off.
            again = jobs()
            with contextlib.redirect_stdout(io.StringIO()):
                run_them([job for job in again if job.name != 'long'], 120)
                run_them([job for job in again if job.name == 'long'], 0.5)
            self.assertEqual({job.name: job.state for job in again if job.state != 'done'},
                             {'fails.a.seed0.0': 'failed', 'nothing.a.seed0.0': 'failed', 'long': 'cut off'})
            self.assertEqual(sum('begin' in line for line in (folder / 'notes').read_text().splitlines()),
                             sum(what == 'begin' for what, _, _ in notes) + 2)  # what failed
            log = [line.split('\t') for line in (folder / 'out/jobs.log').read_text().splitlines()]
            self.assertTrue(all(0 <= float(began) <= float(ended) for began, ended, *_ in log))
            self.assertEqual({tuple(line[2:]) for line in log if line[3] != 'done'},
                             {('3', 'failed', 'fails.a.seed0.0'), ('0', 'failed', 'nothing.a.seed0.0'), ('-9', 'cut off', 'long')})
            (folder / 'out/calls/by_gpu.b.seed1.1.json').unlink()  # as where the time was up
            made = curves.collect(self.PLAN, str(program), folder / 'out', folder / 'curves', 'abc', 'a machine')
            self.assertEqual(made, ['by_gpu', 'meshes', 'parts', 'nothing'])
            together = [json.loads(line)[1] for line in (folder / 'notes').read_text().splitlines() if '--forced", "1"' in line]
            self.assertEqual(len(together[0][together[0].index('--curves') + 1].split(',')), 6)  # of parts, all calls
            by_gpu = json.loads((folder / 'curves/by_gpu.json').read_text())
            self.assertEqual(by_gpu['values'], ','.join(['1,2,3,4'] * 3 + ['1,2']))
            self.assertEqual(by_gpu['made'], {'command': 'work_precision --knob voxel --use_gpu 1 --seeds 0,1 --arguments x=1,y=2',
                                              'commit': 'abc', 'machine': 'a machine'})
            self.assertIn('trained with quality=high', (folder / 'curves/meshes.json').read_text())

    def test_forced_runs_that_ended_count_where_the_call_was_cut_off(self):
        entry = {'name': 'parts', 'forced': ['p', 'q'], 'scenes': ['a', 'b'], 'seeds': [0, 1], 'arguments': ['gaussian_trainer.x=1', 'tsdf_mesher.y=2']}
        with tempfile.TemporaryDirectory() as temporary:
            folder = pathlib.Path(temporary)
            (folder / 'calls').mkdir()
            training = {'knob': 'forced_training', 'error': 'e', 'scenes': ['a'], 'values': ['planned', 'p', 'q'], 'points': ['point']}
            (folder / 'calls/parts.a.seed0.json').write_text(json.dumps({'parts': ['row'], 'curves': [training, {**training, 'knob': 'forced_mesh'}]}))

            def run(value, seed, settings='gaussian_trainer planned x=1', failure='', **figures):
                at = folder / 'scans/parts/b/work_precision/forced_training' / f'{value}_seed{seed}'
                at.mkdir(parents=True)
                (at / 'point.json').write_text(json.dumps({'value': value, 'seed': seed, 'failure': failure, 'settings': settings, 'figures': figures}))
            run('planned', 1, e=4)
            run('p', 1, failure='no memory')
            run('q', 1, settings='gaussian_trainer planned x=10', e=5)  # of another sweep
            run('p', 0, settings='gaussian_trainer planned x=10', e=5)
            cut_off = folder / 'cut_off'
            cut_off.mkdir()
            files = curves.calls_of(entry, folder, cut_off)
            self.assertEqual([path.name for path in files], ['parts.a.seed0.json', 'parts.b.seed1.json'])
            self.assertEqual(json.loads(files[1].read_text()), {'parts': [], 'curves': [
                {**training, 'scenes': ['b'], 'values': ['planned', 'p'], 'points': [
                    {'scene': 0, 'value': 'planned', 'seed': 1, 'failure': '', 'figures': {'e': 4}},
                    {'scene': 0, 'value': 'p', 'seed': 1, 'failure': 'no memory', 'figures': {}}]}]})

    @unittest.skipUnless(hasattr(os, 'sched_setaffinity'), 'cores cannot be dealt out here')
    def test_jobs_of_several_gpus_see_one_each_and_long_ones_are_not_begun_late(self):
        with tempfile.TemporaryDirectory() as temporary:
            folder = pathlib.Path(temporary).resolve()
            note = folder / 'note'
            note.write_text('#!/bin/sh\necho "$1 begins ${CUDA_VISIBLE_DEVICES-none}" >> ' + str(folder) + '/notes; sleep 0.3; '
                            'echo "$1 ends" >> ' + str(folder) + '/notes\n')
            note.chmod(0o755)
            of = lambda name, **more: {'name': name, 'command': [str(note), name], **more}
            plan = [*[of(f'g{i}', gpu=True) for i in range(4)], of('c'), of('late', needs=1000)]
            jobs = curves.jobs_of(plan, 's2gs', folder / 'data', folder / 'out')
            with contextlib.redirect_stdout(io.StringIO()):
                curves.run_jobs(jobs, folder / 'out', 60, [0] * 4, 1, gpus=2, tick=0.01)
            self.assertEqual({job.name: job.state for job in jobs if job.state != 'done'}, {'late': 'waiting'})
            running, seen = {}, {}
            for line in (folder / 'notes').read_text().splitlines():
                name, what, *gpu = line.split()
                if what == 'ends':
                    running.pop(name)
                    continue
                seen[name] = gpu[0]
                self.assertNotIn(gpu[0], running.values())  # one job of a GPU at a time
                running[name] = gpu[0]
            self.assertEqual({seen[name] for name in ('g0', 'g1', 'g2', 'g3')}, {'0', '1'})
            self.assertEqual(seen['c'], os.environ.get('CUDA_VISIBLE_DEVICES', 'none'))

    def test_runs_that_ended_count_where_the_call_was_cut_off(self):
        entry = self.PLAN[0]
        with tempfile.TemporaryDirectory() as temporary:
            folder = pathlib.Path(temporary)
            calls = folder / 'out' / 'calls'
            calls.mkdir(parents=True)
            (calls / 'by_gpu.a.seed0.0.json').write_text(json.dumps({'what': 'edge', 'error': 'e', 'scenes': ['a'], 'points': ['p']}))
            of_sweep = 'tsdf_mesher voxel x=1 y=2 turntable_mapper='

            def ended(value, settings=of_sweep, failure='', **figures):
                run = folder / 'out/scans/by_gpu/b/work_precision/voxel' / f'{value}_seed1'
                run.mkdir(parents=True)
                (run / 'point.json').write_text(json.dumps({'scene': 3, 'value': value, 'seed': 1, 'failure': failure,
                                                            'figures': figures, 'settings': settings}))
            ended('1', e=0.5)
            ended('2', failure='no memory')
            ended('3', settings='tsdf_mesher voxel x=1 y=20', e=0.5)  # of another sweep
            ended('4', faces=7)                                       # its error is not known yet
            cut_off = folder / 'cut_off'
            cut_off.mkdir()
            files = curves.calls_of(entry, folder / 'out', cut_off)
            self.assertEqual([path.name for path in files], ['by_gpu.a.seed0.0.json', 'by_gpu.b.seed1.0.json'])
            self.assertEqual(json.loads(files[1].read_text()),
                             {'what': 'edge', 'error': 'e', 'scenes': ['b'], 'values': ['1', '2'], 'points': [
                                 {'scene': 0, 'value': '1', 'seed': 1, 'failure': '', 'figures': {'e': 0.5}},
                                 {'scene': 0, 'value': '2', 'seed': 1, 'failure': 'no memory', 'figures': {}}]})

    def test_scenes_that_are_not_there_are_left_out_and_named(self):
        with tempfile.TemporaryDirectory() as folder:
            (pathlib.Path(folder) / 'b').mkdir()
            with contextlib.redirect_stderr(io.StringIO()) as said:
                plan = curves.with_scenes_of(self.PLAN, pathlib.Path(folder))
        self.assertEqual([(entry['name'], entry.get('scenes')) for entry in plan],
                         [('by_gpu', ['b']), ('parts', ['b']), ('long', None)])
        self.assertIn('lacks a: left out', said.getvalue())

    def test_the_plan_names_what_there_is(self):
        plan = json.loads((pathlib.Path(curves.HERE) / 'curves.json').read_text())
        known = scenes.read_scenes()
        names = [job.name for job in curves.jobs_of(plan, 's2gs', pathlib.Path('/d'), pathlib.Path('/o'))]
        self.assertEqual(len(names), len(set(names)))
        for entry in plan:
            self.assertLessEqual(set(entry.get('scenes', [])), set(known), entry['name'])


class Plans(unittest.TestCase):
    def test_training_decides_what_the_plan_left_to_it(self):
        decision = lambda part, state: {'part': part, 'what': f'what {part} is', 'state': state, 'measured': '3 | 4', 'threshold': 't',
                                        'reason': 'r', 'saving': 's'}
        event = lambda part, left_out, measured: json.dumps({'event': 'decision', 'part': part, 'left_out': left_out,
                                                             'measured': measured, 'threshold': 'u', 'reason': 'q', 'saving': ''}) + '\n'
        with tempfile.TemporaryDirectory() as temporary:
            folder = pathlib.Path(temporary)
            (folder / 'w/s2gs').mkdir(parents=True)
            (folder / 'w/s2gs/plan.json').write_text(json.dumps({'decisions': [
                decision('pairs', 'runs'), decision('p', 'later'), decision('bands', 'later'),
                {**decision('scale', 'left out'), 'never_forced': 'no bound'}, {**decision('background', 'runs'), 'never_forced': 'one place'}]}))
            (folder / 'log.jsonl').write_text(event('p', False, 'early') + '{"event": "step"}\n' + event('p', True, 'late') +
                                              event('pairs', True, 'no concern of training'))
            out = folder / 'plans.md'
            self.assertEqual(plans.main(['--commit', 'abc', '--output', str(out), f'a={folder}/w', f'b={folder}/w={folder}/log.jsonl']), 0)
            text = out.read_text()
        self.assertIn('| `p`: what p is | not decided | left out |', text)
        self.assertIn('| `pairs`: what pairs is | runs | runs |', text)
        a, b = text.split('## a')[1].split('## b')
        self.assertIn('| `p` | not decided | 3 / 4 | t | r | s |', a)
        self.assertIn('| `p` | left out | late | u | q |  |', b)
        self.assertEqual([line.split('`')[1] for line in b.split('\n') if '`' in line], ['p', 'scale', 'pairs', 'background', 'bands'])
        self.assertIn('| `scale` | left out | 3 / 4 | t | r; nothing to force: no bound | s |', b)
        self.assertIn('| `background` | runs | 3 / 4 | t | r | s |', b)


class Evidence(unittest.TestCase):
    REPORT = {'report': {'verdict': {'verdict': 'good', 'reasons': ['98 % of 114 details that were held back agree with the poses',
                                                                  '616 matches across the end of the turn bear out the poses']},
                         'geometry': {'sigma': {'angle_median_deg': .0141, 'axis_direction_deg': .0064, 'angle_prior_share': .83,
                                                'focal_prior_share': [.003, None]}},
                         'stages': {'plan': [{'part': 'weak_features', 'state': 'runs',
                                              'measured': '50 features a photo, 30 more: standard deviations lower by 13 %'}]}}}
    LOG = """[1s] poses by patches of the photos: points of all, errors of patches that were held back went from 0.0988 px to 0.0922 px
[2s] about the table's rim the log-likelihood of the matches is 11.8 less
path                    circular_motion: placed 36 images
"""

    def test_a_row_tells_what_was_asked_and_what_was_taken(self):
        self.assertEqual(evidence.row('a', self.REPORT, self.LOG),
                         ('a', 'circular_motion', 'good', '0.014, 0.006', '98 % of 114', '616', '-', '-13 %', '0.099 > 0.092', '-',
                          'no', '-', '83 %', '0 %'))

    def test_what_a_scan_lacks_is_left_empty(self):
        report = {'report': {'verdict': {'verdict': 'failed', 'reasons': ['of 52 details that were held back, 21 % agree with the poses']},
                             'stages': {'plan': []}}}
        self.assertEqual(evidence.row('b', report, ''), ('b', '-', 'failed', '-, -', '21 % of 52') + ('-',) * 9)


class Curves(unittest.TestCase):
    CURVE = {'knob': 'voxel', 'what': 'edge', 'error': 'e', 'error_text': 'error [px]', 'reference': 'ground truth', 'scenes': ['a', 'b'],
             'settings': [{'scene': scene, 'value': str(value), 'runs': 1, 'reached': 1, 'pareto': True,
                           'cpu_s': {'min': 7, 'median': 7, 'max': 7},
                           'wall_s': {'min': value, 'median': value, 'max': value},
                           'error': {'min': 1 / value, 'median': 1 / value, 'max': 1 / value}}
                          for scene in (0, 1) for value in (2, 4, 8)]}

    def test_the_time_that_counts(self):
        # 7 CPU seconds all: one place along x; wall seconds stand at three, and each scene has its table and its line.
        by_cpu, by_wall = (report.curve_plot({**self.CURVE, 'time': clock}) for clock in ('cpu', 'wall'))
        places = lambda svg: {word.split('"')[1] for word in svg.split('<circle ')[1:]}
        self.assertEqual((len(places(by_cpu)), len(places(by_wall))), (1, 3))
        self.assertIn('wall seconds', by_wall)
        lines = report.curves_part({'mesh_gpu': {**self.CURVE, 'time': 'wall'}})
        self.assertIn('## Edge (mesh gpu)', lines)
        self.assertIn('a:', lines)
        self.assertIn('b:', lines)
        self.assertIn('wall [s]', '\n'.join(lines))

    def test_files_that_newcomers_are_sent_to_are_there(self):
        repository = scenes.REPOSITORY
        for page in ('CONTRIBUTING.md', 'tests/bench/notes/house.md'):
            folder, named = '', []
            for row in re.findall(r'^\| [^|]+ \| (`[^|]+) \|', (repository / page).read_text(), re.M):
                for path in re.findall(r'`([\w/]+\.(?:h|cc))`', row):
                    folder = path.rpartition('/')[0] or folder  # as in "`a/b.h`, `c.h`"
                    named.append(f'{folder}/{path.rpartition("/")[2]}')
            self.assertGreater(len(named), 19, page)
            self.assertEqual([path for path in named if not (repository / path).exists()], [], page)

    def test_the_first_page_has_one_row_a_sweep(self):
        beaten = {**self.CURVE, 'settings': [{**s, 'pareto': s['value'] != '4'} for s in self.CURVE['settings']]}
        lines = report.curves_lines({'mesh_gpu': {**beaten, 'time': 'wall'}, 'forced': {'parts': []}})
        rows = [line for line in lines if line.startswith('| Edge')]
        self.assertEqual(len(rows), 1)
        self.assertTrue(rows[0].endswith('| wall | a: 2, 8; b: 2, 8 |'), rows[0])
        page = report.curves_page({'mesh_gpu': {**beaten, 'time': 'wall'}})
        self.assertIn('(curves/mesh_gpu.csv)', page)
        self.assertIn('(../plots/curve_mesh_gpu.svg)', page)

    def test_gains_of_parts(self):
        spread = lambda value: {'min': value, 'median': value, 'max': value}
        part = lambda error_of, **more: {'error_of': error_of, 'planned_error': spread(0.2), 'forced_error': spread(0.19),
                                         'gain_pct': 5.0, **more}
        held_out = 'RMS error of held-out photos [of 0 to 1]'
        # Medians say 5 %; the seeds' mean says .002 of .2, with a standard error of .001.
        self.assertEqual(report.gain_cell(part(held_out, mean_gain=0.002, gain_sigma=0.001, gain_sigmas=2)), '+1.00 ± 0.50 %')
        self.assertEqual(report.gain_cell(part(held_out, gain_sigma=0.001, gain_sigmas=-2)), '-1.00 ± 0.50 %')  # older files
        self.assertEqual(report.gain_cell(part(held_out, mean_gain=0, gain_sigma=0, gain_sigmas=None)), '+0.00 ± 0.00 %')
        self.assertEqual(report.gain_cell(part(held_out, gain_sigma=None)), '+5.00 %')
        self.assertEqual(report.gain_cell(part('rotation error of the poses, median [degrees]', gain_sigma=0.04)), '+5.00 %')
        self.assertEqual(report.gain_cell({**part(held_out), 'gain_pct': None}), '')

    def test_method_runs_become_one_table(self):
        with tempfile.TemporaryDirectory() as temporary:
            folder = pathlib.Path(temporary)
            run_of = lambda seed, psnr: {'scene': 'a', 'variant': 'ours', 'seed': seed, 'iterations': 3000, 'psnr_db': psnr}
            (folder / '1.jsonl').write_text(''.join(json.dumps(run_of(s, v)) + '\n' for s, v in ((0, 30.0), (1, 35.0))))
            (folder / '2.jsonl').write_text(json.dumps(run_of(2, 31.0)) + '\n' + json.dumps(run_of(1, 32.0)) + '\n')
            method_tables.merge([str(folder / '1.jsonl'), str(folder / '2.jsonl'), str(folder / 'out')])
            self.assertIn('| ours: the defaults | 31.00 (30.00 to 32.00) |', (folder / 'out' / 'method.md').read_text())
            self.assertEqual(len((folder / 'out' / 'method.jsonl').read_text().splitlines()), 3)


if __name__ == '__main__':
    unittest.main()
