"""Databases exchanged with COLMAP itself.

usage: colmap_database_interop.py colmap|pycolmap DATABASE_TOOL

`colmap` runs the installed executable, `pycolmap` the package in this Python. Each reads what the tool wrote, and
the tool reads what each wrote; all content must be the same.
"""

import json
import os
import pathlib
import shutil
import sqlite3
import subprocess
import sys
import tempfile


def run(*command):
    environment = dict(os.environ, QT_QPA_PLATFORM="offscreen")
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, env=environment)
    if done.returncode != 0:
        sys.exit(f"{command} ended with {done.returncode}:\n{done.stdout}\n{done.stderr}")
    return done.stdout


class Tool:
    def __init__(self, path):
        self.path = path

    def create(self, database):
        run(self.path, "create", database)

    def extend(self, database):
        run(self.path, "extend", database)

    def dump(self, database):
        folder = database.parent
        before = {p.name: p.read_bytes() for p in folder.iterdir()}
        content = json.loads(run(self.path, "dump", database))
        after = {p.name: p.read_bytes() for p in folder.iterdir()}
        assert before == after, "reading changed a file"
        return content


def expect_equal(found, expected, where):
    if type(found) is not type(expected):
        sys.exit(f"{where}: {found!r} instead of {expected!r}")
    if isinstance(expected, dict):
        expect_equal(sorted(found), sorted(expected), where)
        for key in expected:
            expect_equal(found[key], expected[key], f"{where}/{key}")
    elif isinstance(expected, list):
        if len(found) != len(expected):
            sys.exit(f"{where}: {len(found)} entries instead of {len(expected)}")
        for i, (f, e) in enumerate(zip(found, expected)):
            expect_equal(f, e, f"{where}/{i}")
    elif found != expected:
        sys.exit(f"{where}: {found!r} instead of {expected!r}")


def without_priors(content):
    for image in content["images"]:
        image["prior_qvec"] = image["prior_tvec"] = None
    return content


def check_colmap(tool, folder):
    colmap = shutil.which("colmap")
    if colmap is None:
        sys.exit("there is no `colmap` on PATH: install it (on Debian: apt install colmap)")
    print(run(colmap, "help").splitlines()[0])

    ours = folder / "ours" / "ours.db"
    ours.parent.mkdir()
    tool.create(ours)
    content = tool.dump(ours)
    assert len(content["images"]) == 3 and len(content["geometries"]) == 2

    theirs = folder / "theirs" / "empty.db"
    theirs.parent.mkdir()
    run(colmap, "database_creator", "--database_path", theirs)
    expect_equal(tool.dump(theirs), {"cameras": [], "images": [], "matches": {}, "geometries": {}}, "empty")

    # The merger reads every row of ours and writes it again.
    merged = theirs.parent / "merged.db"
    run(colmap, "database_merger", "--database_path1", ours, "--database_path2", theirs,
        "--merged_database_path", merged)
    expect_equal(tool.dump(merged), content, "merged by colmap")
    assert tool.dump(ours) == content

    tool.extend(merged)
    twice = theirs.parent / "twice.db"
    run(colmap, "database_merger", "--database_path1", merged, "--database_path2", theirs,
        "--merged_database_path", twice)
    expect_equal(tool.dump(twice), tool.dump(merged), "extended and merged by colmap")


def read_with_pycolmap(path):
    """The content in the form that the tool prints."""
    import numpy as np
    import pycolmap

    def rows(matrix):
        return None if matrix is None or not np.any(matrix) else np.asarray(matrix, dtype=float).tolist()

    database = pycolmap.Database.open(str(path))
    content = {"cameras": [], "images": [], "matches": {}, "geometries": {}}
    for camera in sorted(database.read_all_cameras(), key=lambda c: c.camera_id):
        content["cameras"].append({
            "id": camera.camera_id, "model": int(camera.model), "width": camera.width, "height": camera.height,
            "params": [float(p) for p in camera.params],
            "has_prior_focal_length": camera.has_prior_focal_length})
    images = sorted(database.read_all_images(), key=lambda i: i.image_id)
    for image in images:
        # The tool prints float32 numbers as the doubles that they are.
        content["images"].append({
            "id": image.image_id, "name": image.name, "camera_id": image.camera_id,
            "prior_qvec": None, "prior_tvec": None,
            "keypoints": database.read_keypoints(image.image_id).astype(float).tolist(),
            "descriptors": database.read_descriptors(image.image_id).data.tolist()})
    for a in images:
        for b in images:
            id1, id2 = a.image_id, b.image_id
            if id1 >= id2 or not database.exists_matches(id1, id2):
                continue
            content["matches"][f"{id1} {id2}"] = database.read_matches(id1, id2).tolist()
            if not database.exists_two_view_geometry(id1, id2):
                continue
            g = database.read_two_view_geometry(id1, id2)
            pose = g.cam2_from_cam1
            x, y, z, w = pose.rotation.quat if pose is not None else (0, 0, 0, 0)
            content["geometries"][f"{id1} {id2}"] = {
                "config": int(g.config), "inlier_matches": np.asarray(g.inlier_matches).tolist(),
                "F": rows(g.F), "E": rows(g.E), "H": rows(g.H),
                "qvec": None if pose is None else [[float(q)] for q in (w, x, y, z)],
                "tvec": None if pose is None else [[float(t)] for t in pose.translation]}
    frames = {data.id: frame.rig_id for frame in database.read_all_frames() for data in frame.data_ids}
    database.close()
    return content, frames


def write_with_pycolmap(path, content):
    import numpy as np
    import pycolmap

    database = pycolmap.Database.open(str(path))
    for c in content["cameras"]:
        camera = pycolmap.Camera(
            camera_id=c["id"], model=pycolmap.CameraModelId(c["model"]), width=c["width"], height=c["height"],
            params=c["params"], has_prior_focal_length=c["has_prior_focal_length"])
        database.write_camera(camera, use_camera_id=True)
    for i in content["images"]:
        image = pycolmap.Image(image_id=i["id"], name=i["name"], camera_id=i["camera_id"])
        database.write_image(image, use_image_id=True)
        database.write_keypoints(i["id"], np.array(i["keypoints"], dtype=np.float32))
        descriptors = pycolmap.FeatureDescriptors()
        descriptors.type = pycolmap.FeatureExtractorType.SIFT
        descriptors.data = np.array(i["descriptors"], dtype=np.uint8)
        database.write_descriptors(i["id"], descriptors)
    for name, pairs in content["matches"].items():
        id1, id2 = map(int, name.split())
        # The other way round, so that COLMAP swaps.
        database.write_matches(id2, id1, np.array(pairs, dtype=np.uint32)[:, ::-1])
    for name, g in content["geometries"].items():
        id1, id2 = map(int, name.split())
        geometry = pycolmap.TwoViewGeometry()
        geometry.config = pycolmap.TwoViewGeometryConfiguration(g["config"])
        geometry.inlier_matches = np.array(g["inlier_matches"], dtype=np.uint32)
        for key in "FEH":
            if g[key] is not None:
                setattr(geometry, key, np.array(g[key]))
        if g["qvec"] is not None:
            w, x, y, z = (q for (q,) in g["qvec"])
            translation = [t for (t,) in g["tvec"]]
            geometry.cam2_from_cam1 = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([x, y, z, w])), translation)
        database.write_two_view_geometry(id1, id2, geometry)
    database.close()


def check_pycolmap(tool, folder):
    import pycolmap
    print("pycolmap", pycolmap.__version__)

    ours = folder / "ours" / "ours.db"
    ours.parent.mkdir()
    tool.create(ours)
    content = without_priors(tool.dump(ours))

    # It migrates what it opens.
    migrated = folder / "migrated" / "migrated.db"
    migrated.parent.mkdir()
    shutil.copy(ours, migrated)
    found, _ = read_with_pycolmap(migrated)
    expect_equal(found, content, "read by pycolmap")
    assert sqlite3.connect(migrated).execute("PRAGMA user_version").fetchone()[0] > 4000000
    expect_equal(without_priors(tool.dump(migrated)), content, "migrated by pycolmap")

    theirs = folder / "theirs" / "theirs.db"
    theirs.parent.mkdir()
    write_with_pycolmap(theirs, content)
    expect_equal(tool.dump(theirs), content, "written by pycolmap")

    for database in (migrated, theirs):
        tool.extend(database)
        extended = without_priors(tool.dump(database))
        assert len(extended["images"]) == 4 and "1 4" in extended["geometries"]
        found, frames = read_with_pycolmap(database)
        expect_equal(found, extended, f"{database.name} extended")
        assert 4 in frames, "the new image has no frame"


def main():
    kind, tool = sys.argv[1], Tool(sys.argv[2])
    with tempfile.TemporaryDirectory() as folder:
        {"colmap": check_colmap, "pycolmap": check_pycolmap}[kind](tool, pathlib.Path(folder))
    print("all content is the same")


if __name__ == "__main__":
    main()
