"""The scenes that are measured: where each lies, how a made-up one is rendered, and what tells that it is the same."""
import hashlib
import json
import pathlib
import shlex
import shutil
import subprocess
import sys

HERE = pathlib.Path(__file__).resolve().parent
REPOSITORY = HERE.parent.parent


def read_scenes(path=HERE / 'scenes.json'):
    """{name: its entry, with 'kind': shipped, shared or rendered}"""
    kinds = json.loads(path.read_text())
    return {name: {**entry, 'kind': kind} for kind in ('shipped', 'shared', 'rendered')
            for name, entry in kinds[kind].items()}


def folder_hash(folder):
    """SHA-256 of a scene: names and bytes of all its photos and of its truth, 16 digits of it."""
    digest = hashlib.sha256()
    for path in sorted(p for sub in ('images', 'images_test', 'gt', 'masks', 'reference.json')
                       for p in ([folder / sub] if (folder / sub).is_file() else (folder / sub).rglob('*')) if p.is_file()):
        digest.update(path.relative_to(folder).as_posix().encode() + b'\0')
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:16]


def find_scene(name, entry, data, find_python):
    """The scene's folder: DATA/NAME where it is there; else what the repository ships, ../shared/data or a rendering
    into DATA/NAME. `find_python` returns a Python that can render. Raises FileNotFoundError with what to do."""
    folder = data / name
    if folder.exists():
        return folder
    if entry['kind'] == 'shipped':
        return REPOSITORY / entry['path']
    if entry['kind'] == 'shared':
        for parent in REPOSITORY.parents:
            if (parent / 'shared/data' / entry['path']).exists():
                return parent / 'shared/data' / entry['path']
        raise FileNotFoundError(f'{name}: neither {folder} nor ../shared/data/{entry["path"]} is there')
    try:
        python = find_python()
    except FileNotFoundError as error:
        raise FileNotFoundError(f'{name}: not in {data}, and to render it there is {error}') from error
    unfinished = data / f'{name}.unfinished'
    shutil.rmtree(unfinished, ignore_errors=True)
    print(f'rendering {name}', flush=True)
    if subprocess.run([python, HERE / 'render_scene.py', unfinished, *shlex.split(entry['arguments'])]).returncode != 0:
        raise FileNotFoundError(f'{name}: it could not be rendered')
    unfinished.rename(folder)
    return folder


def check_hash(name, entry, found):
    """A line to print when the scene is not the recorded one or has no record."""
    if entry['hash'] is None:
        return f'{name}: no hash recorded; this one has {found}'
    if entry['hash'] != found:
        return f'{name}: differs from the recorded scene ({found}, recorded {entry["hash"]}): another version of a ' \
               'library may have rendered it'
    return None


def main():
    """usage: scenes.py NAME FOLDER: prints a folder's hash and whether it is the recorded scene."""
    name, folder = sys.argv[1], pathlib.Path(sys.argv[2])
    found = folder_hash(folder)
    print(check_hash(name, read_scenes()[name], found) or f'{name}: {found}, as recorded')


if __name__ == '__main__':
    main()
