"""Builds broken programs beside a built tree: only what a broken file changes is compiled, nothing in the tree is touched.

A description of the tree (describe) holds how each object is compiled and what it depends on, and how each program is
linked. It can be carried to another machine together with sources, objects and libraries.
"""
import json
import os
import pathlib
import re
import shlex
import subprocess

ROOT = '@ROOT@'


def output_of(command, **more):
    return subprocess.run(command, check=True, capture_output=True, text=True, **more).stdout


def inside(path, folder):
    path = os.path.relpath(path, folder)
    return None if path.startswith('..') else path


def describe(root, build, programs):
    """{commit, objects: {object: {file, words, deps}}, links: {program: words}}; paths in the tree, objects in the build folder."""
    # As CMake was told: where the tree's name is a link, compilers are given that.
    named = re.search(r'^CMAKE_CACHEFILE_DIR:INTERNAL=(.*)$', (build / 'CMakeCache.txt').read_text(), re.M)[1]
    if named.endswith(inner := f'/{os.path.relpath(build, root)}'):
        root, build = pathlib.Path(named[:-len(inner)]), pathlib.Path(named)
    depends, object_name = {}, None
    for line in output_of(['ninja', '-C', str(build), '-t', 'deps']).split('\n'):
        if match := re.match(r'(\S+): #deps', line):
            object_name = match[1]
            depends[object_name] = []
        elif line.startswith('    '):
            path = inside(os.path.normpath(build / line.strip()), root)
            if path and not path.startswith('build/'):
                depends[object_name].append(path)
    objects = {}
    for entry in json.loads((build / 'compile_commands.json').read_text()):
        words = [w for w in shlex.split(entry['command']) if not w.endswith('ccache')]
        name = words[words.index('-o') + 1]
        words = words[:words.index('-o')]
        file = inside(entry['file'], root)
        if file and name in depends:
            objects[name] = {'file': file, 'words': [w.replace(str(root), ROOT) for w in words], 'deps': depends[name]}
    links = {}
    for program in programs:
        command = output_of(['ninja', '-C', str(build), '-t', 'commands', '-s', program]).splitlines()[-1]
        command = next(part for part in re.split(r'(?:^|\s)&&(?:\s|$)', command) if ' -o ' in part)
        links[program] = [w.replace(str(root), ROOT) for w in shlex.split(command)]
    commit = output_of(['git', 'rev-parse', 'HEAD'], cwd=root).strip()
    return {'commit': commit, 'objects': objects, 'links': links}


def archive_of(object_name):
    """The library that holds an object: CMake's folders name it."""
    match = re.match(r'(.*)CMakeFiles/(\w+)\.dir/', object_name)
    return f'{match[1]}lib{match[2]}.a'


class BuiltTree:
    def __init__(self, root, build, description):
        self.root, self.build = pathlib.Path(root), pathlib.Path(build)
        self.objects, self.links, self.commit = description['objects'], description['links'], description['commit']

    def words(self, words):
        return [w.replace(ROOT, str(self.root)) for w in words]

    def objects_of(self, path, program):
        """Objects of a program that a file is part of."""
        link = set(self.links[program])
        return [name for name, o in self.objects.items() if (o['file'] == path or path in o['deps'])
                and (name in link or archive_of(name) in link)]

    def compile(self, name, overlay, out, seconds):
        """Error text, or None. Files in the folder `overlay` stand for those of the tree."""
        o = self.objects[name]
        source = overlay / o['file']
        words = self.words(o['words'])
        command = [words[0], f'-I{overlay}', f'-ffile-prefix-map={overlay}={self.root}', *words[1:], '-w', '-o', str(out),
                   '-c', str(source if source.exists() else self.root / o['file'])]
        out.parent.mkdir(parents=True, exist_ok=True)
        done = subprocess.run(command, cwd=self.build, capture_output=True, text=True, timeout=seconds)
        return None if done.returncode == 0 else done.stderr[:1500]

    def link(self, program, replaced, out):
        """Error text, or None. `replaced` is {object: file that stands for it}; those of libraries are linked before these."""
        words = self.words(self.links[program])
        own = [str(file) for name, file in replaced.items() if name not in words]
        words = [str(replaced[w]) if w in replaced else w for w in words]
        at = words.index('-o')
        words[at + 1] = str(out)
        words[at + 2:at + 2] = own
        out.parent.mkdir(parents=True, exist_ok=True)
        done = subprocess.run(words, cwd=self.build, capture_output=True, text=True)
        return None if done.returncode == 0 else done.stderr[:1500]
