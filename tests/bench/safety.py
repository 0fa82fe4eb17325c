"""Results of suite `safety`: fuzzing, the hostile cases, killed scans. Their programs lie in tests/fuzz and tests/hostile."""
import pathlib

import results
import run
import scenes


def record(scene, variant, command, exit_code, figures, folder=None):
    """Writes one result and returns its path. `command`: as one would type it, without this machine's paths."""
    return results.write_result(folder or results.RESULTS, {
        'suite': 'safety', 'scene': scene, 'variant': variant, 'seed': 0, 'commit': run.commit_of(scenes.REPOSITORY),
        'machine': run.machine(gpu=False), 'command': [command], 'data_hash': '', 'recorded': 'by run.py',
        'exit_code': exit_code, 'figures': figures})


def recorded(scene, variant, folder=None):
    """The figures of the last such result; none when there is none."""
    stub = {'scene': scene, 'variant': variant, 'seed': 0, 'machine': run.machine(gpu=False), 'suite': 'safety'}
    path = pathlib.Path(folder or results.RESULTS) / results.file_name(stub)
    return results.parse(path.read_text(), path)['figures'] if path.exists() else {}
