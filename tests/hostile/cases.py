"""The hostile cases: what each lays down, what it runs, and what it wants to see."""
import dataclasses
import json
import os
import pathlib
import shutil
import sqlite3
import struct
import subprocess
import typing
import zlib

import cv2
import numpy as np

import sandbox

NOBODY = 65534
EXAMPLE = pathlib.Path(__file__).resolve().parents[2] / "examples" / "falcon_desk" / "images"


class CannotRun(Exception):
    """This machine lacks what the case needs."""


@dataclasses.dataclass
class Want:
    code: typing.Optional[int] = 1
    says: tuple = ()
    not_says: tuple = ()
    then: typing.Optional[typing.Callable] = None
    needs_message: bool = True
    max_cpu_seconds: float = sandbox.MAX_CPU_SECONDS


@dataclasses.dataclass
class Case:
    group: str
    name: str
    prepare: typing.Callable  # of the sandbox: what is wanted, the arguments, and options of Sandbox.run


# --- Commands ----------------------------------------------------------------------------------------------------------

def scanner(box, *more, colmap=None):
    colmap = colmap or sandbox.fake_colmap(box.folder / "colmap", "@OPTIONS@\necho no features here; exit 3")
    return ["automatic_scanner", "--workspace_path", box.scan, "--image_path", box.photos, "--colmap_path", colmap, *more]


def renderer(box, *more):
    return ["gaussian_renderer", "--workspace_path", box.scan, "--image_path", box.photos, "--use_gpu", "0", *more]


def trainer(box, *more):
    return ["gaussian_trainer", "--workspace_path", box.scan, "--image_path", box.photos, "--use_gpu", "0",
            "--Train.num_iterations", "3", "--max_image_size", "48", "--Init.min_points", "100", *more]


def mesher(box, *more):
    return ["tsdf_mesher", "--workspace_path", box.scan, "--use_gpu", "0", "--Refine.enabled", "0", *more]


def splitter(box, *more):
    return ["motion_splitter", "--database_path", box.scan / "database.db", *more]


# --- What is laid down -------------------------------------------------------------------------------------------------

def write_database(path, names, width=400, height=400, focal=480.0):
    """A database as COLMAP 3.8 makes it, with a few features of each image."""
    path.parent.mkdir(parents=True, exist_ok=True)
    db = sqlite3.connect(path)
    db.executescript("""
CREATE TABLE cameras (camera_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, model INTEGER NOT NULL, width INTEGER NOT NULL,
  height INTEGER NOT NULL, params BLOB, prior_focal_length INTEGER NOT NULL);
CREATE TABLE images (image_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, name TEXT NOT NULL UNIQUE, camera_id INTEGER NOT NULL,
  prior_qw REAL, prior_qx REAL, prior_qy REAL, prior_qz REAL, prior_tx REAL, prior_ty REAL, prior_tz REAL);
CREATE TABLE keypoints (image_id INTEGER PRIMARY KEY NOT NULL, rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB);
CREATE TABLE descriptors (image_id INTEGER PRIMARY KEY NOT NULL, rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB);
CREATE TABLE matches (pair_id INTEGER PRIMARY KEY NOT NULL, rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB);
CREATE TABLE two_view_geometries (pair_id INTEGER PRIMARY KEY NOT NULL, rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB,
  config INTEGER NOT NULL, F BLOB, E BLOB, H BLOB, qvec BLOB, tvec BLOB);
PRAGMA user_version = 3800;""")
    db.execute("INSERT INTO cameras VALUES (1, 0, ?, ?, ?, 0)", (width, height, struct.pack("<3d", focal, 200, 200)))
    random = np.random.default_rng(1)
    for i, name in enumerate(names):
        keypoints = random.uniform(0, 400, (40, 2)).astype("<f4")
        descriptors = random.integers(0, 80, (40, 128)).astype("u1")
        db.execute("INSERT INTO images(image_id, name, camera_id) VALUES (?, ?, 1)", (i + 1, name))
        db.execute("INSERT INTO keypoints VALUES (?, 40, 2, ?)", (i + 1, keypoints.tobytes()))
        db.execute("INSERT INTO descriptors VALUES (?, 40, 128, ?)", (i + 1, descriptors.tobytes()))
    db.commit()
    db.close()


def write_flat_png(path, side):
    """A grey picture of one colour."""
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    packer = zlib.compressobj(9)
    row = b"\0" * (side + 1)
    data = b"".join(packer.compress(row) for _ in range(side)) + packer.flush()
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)) +
                     chunk(b"IDAT", data) + chunk(b"IEND", b""))


def names_of(box):
    return sorted(path.name for path in box.photos.iterdir())


def edit(path, old, new):
    data = path.read_bytes()
    assert old in data, (path, old)
    path.write_bytes(data.replace(old, new, 1))


def edit_model(folder, old, new):
    """Replaces bytes in images.txt, writing the model as text first."""
    if not (folder / "images.txt").exists():
        subprocess.run(["colmap", "model_converter", "--input_path", folder, "--output_path", folder, "--output_type", "TXT"],
                       check=True, stdout=subprocess.DEVNULL)
        for path in folder.glob("*.bin"):
            path.unlink()
    edit(folder / "images.txt", old, new)


def hostile_names(box):
    original = os.fsencode(box.photos / names_of(box)[0])
    return {"absolute": original, "leads out": b"../photos/" + original.rsplit(b"/", 1)[1],
            "leads out later": b"a/../../photos/" + original.rsplit(b"/", 1)[1], "backslash": b"a\\b.jpg",
            "escape": b"\x1b[2Jx.jpg", "not UTF-8": b"\xff\xfe.jpg", "twice a slash": b"a//b.jpg", "point": b"./a.jpg",
            "long": b"d/" * 600 + b"a.jpg", "long part": b"x" * 250 + b".jpg"}


# --- Names ---------------------------------------------------------------------------------------------------------------

def name_in(reader, which):
    def prepare(box):
        box.use_workspace()
        first = names_of(box)[0].encode()
        name = hostile_names(box)[which]
        says = (r"name",)
        if reader in ("sparse/0", "sparse/static"):
            edit(box.scan / reader / "images.txt", first, name)
            # So that the photo is undistorted, not copied, and belongs to the table's motion.
            (box.scan / reader / "cameras.txt").write_text("1 SIMPLE_RADIAL 400 400 480 200 200 0.05\n")
            text = name.decode("utf-8", "replace").replace("\\", "\\\\").replace("\x1b", "")
            edit(box.scan / "turntable.json", first, text.encode())
            box.forget("gaussian_renderer", "image_undistorter")
            return Want(1, says), renderer(box), {}
        if reader == "images.bin":
            shutil.rmtree(box.scan / "sparse" / "0")
            sandbox.write_binary_model(box.scan / "sparse" / "0", name)
            box.forget("gaussian_trainer")
            return Want(1, says), trainer(box), {}
        if reader == "turntable.json":
            data = json.loads((box.scan / "turntable.json").read_text())
            data["images"][0]["name"] = name.decode("utf-8", "replace") if which != "not UTF-8" else "x\u0000.jpg"
            (box.scan / "turntable.json").write_text(json.dumps(data))
            box.forget("gaussian_trainer")
            return Want(1, says), trainer(box), {}
        if reader == "dense/0/sparse":
            folder = box.scan / "dense" / "0" / "sparse"
            for path in folder.glob("*"):
                path.unlink()
            sandbox.write_binary_model(folder, name)
            return Want(1, says), mesher(box, "--output_path", box.scan / "mesh.ply"), {}
        if reader == "database":
            names = names_of(box)
            write_database(box.scan / "database.db", names)
            db = sqlite3.connect(box.scan / "database.db")
            db.execute("UPDATE images SET name = CAST(? AS TEXT) WHERE image_id = 1", (name,))
            db.commit()
            db.close()
            return Want(1, says), splitter(box, "--image_path", box.photos), {}
        if reader == "labels.json":
            write_database(box.scan / "database.db", names_of(box))
            (box.scan / "split").mkdir()
            for kind in ("object", "static"):
                shutil.copyfile(box.scan / "database.db", box.scan / "split" / f"{kind}.db")
            text = name.decode("utf-8", "replace") if which != "not UTF-8" else "x\u0000.jpg"
            labels = {"version": 1, "case": "turntable", "images": [{"name": text, "station": 0, "labels": ""}]}
            (box.scan / "split" / "labels.json").write_text(json.dumps(labels))
            return Want(1, says), ["turntable_mapper", "--workspace_path", box.scan, "--image_path", box.photos], {}
        raise AssertionError(reader)
    return Case("names", f"{which} in {reader}", prepare)


READERS = ["sparse/0", "sparse/static", "images.bin", "turntable.json", "dense/0/sparse", "database", "labels.json"]
NAMES = ["absolute", "leads out", "leads out later", "backslash", "escape", "not UTF-8", "twice a slash", "point", "long",
         "long part"]


def names_in_another_order(box):
    """A turn's photos under two sets of names that tell nothing: the split puts the same photos in the same order."""
    def lay_down(seed):
        shutil.rmtree(box.scan, ignore_errors=True)
        shutil.rmtree(box.photos)
        box.photos.mkdir()
        photos = sorted(EXAMPLE.glob("s1_*"))
        for number, photo in zip(np.random.default_rng(seed).permutation(len(photos)), photos):
            shutil.copyfile(photo, box.photos / f"p{number:04d}.jpg")
        write_database(box.scan / "database.db", names_of(box))

    def order_found():
        images = json.loads((box.scan / "split" / "labels.json").read_text())["images"]
        return [(box.photos / image["name"]).read_bytes() for image in images]
    arguments = splitter(box, "--image_path", box.photos)
    lay_down(1)
    subprocess.run([box.program] + [os.fspath(a) for a in arguments], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    first = order_found()
    lay_down(2)
    return (Want(0, ("the pictures tell it",), then=lambda box, run: [] if order_found() == first else ["the order differs"]),
            arguments, {})


def link_out(box):
    box.use_workspace()
    (box.folder / "outside").mkdir()
    shutil.rmtree(box.scan / "masks")
    (box.scan / "masks").symlink_to(box.folder / "outside")
    box.forget("gaussian_renderer")
    return Want(1, ("outside", "symbolic link")), renderer(box), {}


def link_to_photo(box):
    box.use_workspace()
    name = names_of(box)[0]
    (box.scan / "masks" / f"{name}.png").unlink()
    (box.scan / "masks" / f"{name}.png").symlink_to(box.photos / name)
    box.forget("gaussian_renderer")
    return Want(1, ("nothing is written",)), renderer(box), {}


def split_leads_out(box):
    (box.folder / "outside").mkdir()
    write_database(box.scan / "database.db", names_of(box))
    (box.scan / "split").symlink_to(box.folder / "outside")
    return Want(1, ("scan/split: is a symbolic link", "nothing is written there")), splitter(box), {}


def lock_is_a_photo(box):
    box.use_workspace()
    (box.scan / "s2gs" / "lock").unlink(missing_ok=True)
    (box.scan / "s2gs" / "lock").symlink_to(box.photos / names_of(box)[0])
    return Want(1, ("s2gs/lock: is a symbolic link",)), trainer(box), {}


def mapper_into_a_link(box):
    """The stage that would write the model through it."""
    write_database(box.scan / "database.db", names_of(box))
    split = box.scan / "split"
    split.mkdir()
    for kind in ("object", "static"):
        shutil.copyfile(box.scan / "database.db", split / f"{kind}.db")
    images = [{"name": name, "station": 0, "labels": "2" * 40} for name in names_of(box)]
    (split / "labels.json").write_text(json.dumps({"version": 1, "case": "turntable", "images": images}))
    (box.folder / "outside").mkdir()
    (box.scan / "sparse").symlink_to(box.folder / "outside")
    return (Want(1, ("scan/sparse: is a symbolic link",)),
            ["turntable_mapper", "--workspace_path", box.scan, "--image_path", box.photos, "--path", "circular_motion"], {})


def link_in_the_workspace(link, arguments_of):
    """Photos that lie in the workspace, and a link to one of them where a file is written."""
    def prepare(box):
        box.use_workspace()
        photo = photos_in_workspace(box) / names_of(box)[0]
        place = box.scan / link
        place.parent.mkdir(parents=True, exist_ok=True)
        place.unlink(missing_ok=True)
        place.symlink_to(os.path.relpath(photo, place.parent))
        want = Want(1, ("is a symbolic link that leads to .*another file",), then=keeps(box.scan / "images"))
        arguments = arguments_of(box)
        arguments[arguments.index("--image_path") + 1] = box.scan / "images"
        return want, arguments, {}
    return Case("links", f"{link} is a link to a photo of the workspace", prepare)


def photos_in_workspace(box):
    shutil.copytree(box.photos, box.scan / "images")
    return box.scan / "images"


def keeps(folder):
    """What must be the same in a folder that the program could write in."""
    before = sandbox.fingerprint(folder)

    def then(box, run):
        return [] if sandbox.fingerprint(folder) == before else [f"{folder.name} changed"]
    return then


def importer(box, *more):
    return ["photo_importer", "--workspace_path", box.scan, "--image_path", box.photos, *more]


def import_through_a_link(box):
    """The workspace's record calls photos its own that a link leads to, and of another version."""
    box.use_workspace()
    photos = photos_in_workspace(box)
    (box.scan / "imported").mkdir()
    (box.scan / "imported" / "sub").symlink_to("../images")
    record = {"origin": "photos, s2gs 0", "photos": [f"sub/{name}" for name in names_of(box)]}
    (box.scan / "s2gs" / "imported.json").write_text(json.dumps(record))
    return Want(1, ("imported/sub: is a symbolic link",), then=keeps(photos)), importer(box), {}


def import_into_the_photos(box):
    (box.photos / "scan").mkdir()
    return (Want(1, ("imported photos are written",)),
            ["photo_importer", "--workspace_path", box.photos / "scan", "--image_path", box.photos], {})


def import_what_was_imported(box):
    (box.scan / "imported").mkdir(parents=True)
    shutil.copyfile(box.photos / names_of(box)[0], box.scan / "imported" / "a.jpg")
    (box.scan / "s2gs").mkdir()
    (box.scan / "s2gs" / "imported.json").write_text(json.dumps({"origin": "other", "photos": ["a.jpg"]}))
    return (Want(1, ("imported photos are written",), then=keeps(box.scan / "imported")),
            ["photo_importer", "--workspace_path", box.scan, "--image_path", box.scan / "imported"], {})


def import_nothing(box):
    (box.scan / "none").mkdir(parents=True)
    (box.scan / "none" / "a.raw").write_text("of a kind that no suffix tells")
    return (Want(1, ("has no photos",)),
            ["photo_importer", "--workspace_path", box.scan, "--image_path", box.scan / "none"], {})


def tiff_of_many_tags(box):
    entry = struct.pack("<HHII", 273, 4, 1 << 20, 8)
    (box.photos / "x.tif").write_bytes(struct.pack("<2sHIH", b"II", 42, 8, 65535) + 65535 * entry + bytes(1 << 22))
    return Want(1, ("x.tif: ",)), importer(box), {}


def exporter(box, kind, output, *more):
    return ["model_exporter", "--workspace_path", box.scan, "--image_path", box.photos, "--output_type", kind,
            "--output_path", output, *more]


def exported_over(kind, place, says, make=None):
    """An export to where photos, the workspace's own files or other pictures lie."""
    def prepare(box):
        box.use_workspace()
        photos_in_workspace(box)
        if make is not None:
            make(box)
        parts = [box.scan / part for part in ("images", "masks", "sparse", "dense")]
        checks = [keeps(part) for part in parts]
        turntable = (box.scan / "turntable.json").read_bytes()

        def then(box, run):
            faults = [fault for check in checks for fault in check(box, run)]
            return faults + ([] if (box.scan / "turntable.json").read_bytes() == turntable else ["turntable.json changed"])
        return Want(1, says, then=then), exporter(box, kind, place(box)), {}
    return Case("exports", f"{kind} over {place.__name__}", prepare)


def the_workspace(box):
    return box.scan


def the_photos(box):
    return box.photos


def a_photo(box):
    return box.photos / names_of(box)[0]


def turntable_json(box):
    return box.scan / "turntable.json"


def other_pictures(box):
    return box.folder / "project"


def make_other_pictures(box):
    (box.folder / "project" / "images").mkdir(parents=True)
    for name in names_of(box):
        (box.folder / "project" / "images" / name).write_bytes(b"the original")


def plan_over_a_photo(box):
    return (Want(1, ("ends in .json",)),
            ["scan_planner", "--image_path", box.photos, "--output_path", box.photos / names_of(box)[0]], {})


def batch_over_a_page(box):
    (box.folder / "list.csv").write_text("images,workspace\nphotos,scan\n")
    (box.folder / "list").mkdir()
    (box.folder / "list" / "index.html").write_text("mine")
    return Want(1, ("list/index.html: is there already",)), ["scan_batch", "--list", box.folder / "list.csv", "--run", "0"], {}


def batch_among_photos(box):
    (box.folder / "list.csv").write_text("images,workspace\nphotos,a\nphotos,photos/scan\n")
    return (Want(0, ("lies among the photos of line",)),
            ["scan_batch", "--list", box.folder / "list.csv", "--run", "0", "--output_path", box.scan], {})


def batch_of_many(box):
    (box.folder / "list.csv").write_text("images,workspace\n" + "".join(f"photos,w{i}/s\n" for i in range(1000)))
    return (Want(0, ("1000 waiting",)),
            ["scan_batch", "--list", box.folder / "list.csv", "--run", "0", "--output_path", box.scan], {})


def endless_angles(box):
    with open(box.folder / "angles.csv", "wb") as stream:
        stream.truncate(1 << 33)
    os.rename(box.folder / "angles.csv", box.folder.parent / (box.folder.name + ".angles.csv"))  # not to be hashed
    return (Want(1, ("bytes long",), then=lambda box, run: no_workspace(box)),
            scanner(box, "--angles_path", box.folder.parent / (box.folder.name + ".angles.csv")), {})


def scan_with_links(box):
    """All of them are named at once."""
    (box.scan / "sparse" / "0").mkdir(parents=True)
    (box.folder / "outside").mkdir()
    (box.folder / "other.json").write_text("{}")
    photo = box.photos / names_of(box)[0]
    for link, target in [("split", box.folder / "outside"), ("dense", box.folder / "outside"),
                         ("sparse/0/images.bin", photo), ("turntable.json", box.folder / "other.json"),
                         ("report.html", box.folder / "new.html"), ("database.db", box.folder / "new.db")]:
        (box.scan / link).symlink_to(target)
    says = tuple(f"scan/{name}: is a symbolic link" for name in
                 ("split", "dense", "sparse/0/images.bin", "turntable.json", "report.html", "database.db"))
    return Want(1, says, (r"runs \(",)), scanner(box), {}


def photos_in_dense(box):
    box.use_workspace()
    images = box.scan / "dense" / "0" / "images"
    prints = sandbox.fingerprint(images)
    shutil.rmtree(box.scan / "dense" / "0" / "sparse")

    def then(box, run):
        return [] if sandbox.fingerprint(images) == prints else ["the photos in dense/0/images changed"]
    arguments = renderer(box)
    arguments[arguments.index("--image_path") + 1] = images
    return Want(1, ("photo",), then=then), arguments, {}


# --- Options -------------------------------------------------------------------------------------------------------------

def scanner_option(name, value, says, code=2):
    def prepare(box):
        return Want(code, says, (r"\d\.\d{6}", "runs \\("), lambda box, run: no_workspace(box)), scanner(box, name, value), {}
    return Case("options", f"{name} {value}", prepare)


def no_workspace(box):
    return ["the workspace was begun"] if box.scan.exists() else []


def all_at_once(box):
    (box.photos / "a.tif").write_bytes(b"II*\0")
    (box.photos / "empty.jpg").write_bytes(b"")
    return (Want(1, ("test_every", "use_gpu", "num_iterations", "max_image_size", "a.tif", "empty.jpg", "nowhere"),
                 then=lambda box, run: no_workspace(box)),
            scanner(box, "--test_every", "1", "--use_gpu", "yes", "--num_iterations", "0", "--max_image_size", "5",
                    "--mask_path", box.folder / "nowhere"), {})


def half_masks(box):
    (box.folder / "masks").mkdir()
    for name in names_of(box)[::2]:
        cv2.imwrite(str(box.folder / "masks" / f"{name}.png"), np.full((400, 400), 255, np.uint8))
    return (Want(1, ("4 of 8 photos have no mask",), then=lambda box, run: no_workspace(box)),
            scanner(box, "--mask_path", box.folder / "masks"), {})


def small_mask(box):
    (box.folder / "masks").mkdir()
    for i, name in enumerate(names_of(box)):
        cv2.imwrite(str(box.folder / "masks" / f"{name}.png"), np.full((400 - i // 7, 400), 255, np.uint8))
    return Want(1, ("400 x 399 pixels, its photo 400 x 400",)), scanner(box, "--mask_path", box.folder / "masks"), {}


def mesh_into_nowhere(box):
    box.use_workspace()
    return (Want(1, ("there is no folder",), ("fused",)), mesher(box, "--output_path", box.scan / "nowhere" / "mesh.ply"), {})


def tsdf_memory(value):
    def prepare(box):
        box.use_workspace()
        return Want(2, ("max_memory_gib",)), mesher(box, "--output_path", box.scan / "m.ply", "--Tsdf.max_memory_gib", value), {}
    return Case("options", f"--Tsdf.max_memory_gib {value}", prepare)


# --- Photos --------------------------------------------------------------------------------------------------------------

def with_photo(group_name, change, says, code=1, not_says=("runs \\(",)):
    def prepare(box):
        change(box)
        return Want(code, says, not_says, lambda box, run: no_workspace(box) if not_says else []), scanner(box), {}
    return Case("photos", group_name, prepare)


def foreign_formats(box):
    picture = np.zeros((40, 40, 3), np.uint8)
    for extension in ("tif", "bmp", "webp"):
        cv2.imwrite(str(box.photos / f"x.{extension}"), picture)
    (box.photos / "y.HEIC").write_bytes(b"\0\0\0\x18ftypheic")


def raw_beside_jpeg(box):
    (box.photos / names_of(box)[0].replace(".jpg", ".CR2")).write_bytes(b"II*\0raw")


def mac_files(box):
    for name in names_of(box):
        (box.photos / ("._" + name)).write_bytes(b"\0\x05\x16\x07\0\x02\0\0Mac OS X")
    (box.photos / ".DS_Store").write_bytes(b"\0")


def rename_first(name):
    def change(box):
        first = box.photos / names_of(box)[0]
        target = os.fsencode(box.photos) + b"/" + name
        os.makedirs(os.path.dirname(target), exist_ok=True)
        os.rename(os.fsencode(first), target)
    return change


def cut_photo(box):
    path = box.photos / names_of(box)[0]
    path.write_bytes(path.read_bytes()[:-3000])


def cut_png(box):
    picture = np.random.default_rng(0).integers(0, 255, (400, 400), dtype=np.uint8)
    cv2.imwrite(str(box.photos / "x.png"), picture)
    (box.photos / "x.png").write_bytes((box.photos / "x.png").read_bytes()[:-5000])


def differ_in_case(box):
    name = names_of(box)[0]
    shutil.copyfile(box.photos / names_of(box)[1], box.photos / name.upper())


def keep_photos(count):
    def change(box):
        for name in names_of(box)[count:]:
            (box.photos / name).unlink()
    return change


def identical_photos(box):
    names = names_of(box)
    for name in names[1:]:
        shutil.copyfile(box.photos / names[0], box.photos / name)


def broken_link(box):
    (box.photos / "x.jpg").symlink_to("nowhere.jpg")


def linked_folder(box):
    (box.folder / "station2").mkdir()
    shutil.copy(box.photos / names_of(box)[0], box.folder / "station2" / "y.jpg")
    (box.photos / "station2").symlink_to(box.folder / "station2")


def pipe(box):
    os.mkfifo(box.photos / "x.jpg")


def workspace_in_photos(box):
    return (Want(1, ("lies in the photos' folder",)),
            ["automatic_scanner", "--workspace_path", box.photos / "scan", "--image_path", box.photos], {})


def hidden_files_pass(box):
    """Past the check, up to the extractor, which gets a list without them."""
    mac_files(box)
    colmap = sandbox.fake_colmap(box.folder / "colmap", f"@OPTIONS@\ncat {box.scan}/database.db.extracting.txt; exit 3")

    def then(box, run):
        return [] if "\n  " + names_of(box)[-1] in run.text and "\n  ._" not in run.text else ["colmap got other photos"]
    return Want(1, ("hidden files", "colmap feature_extractor failed"), then=then), scanner(box, colmap=colmap), {}


# --- Numbers -------------------------------------------------------------------------------------------------------------

def camera(line, says, name):
    def prepare(box):
        box.use_workspace()
        (box.scan / "sparse" / "0" / "cameras.txt").write_text(line + "\n")
        box.forget("gaussian_renderer", "image_undistorter")
        return Want(1, says), renderer(box), {}
    return Case("numbers", name, prepare)


def wide_binary_camera(box):
    box.use_workspace()
    shutil.rmtree(box.scan / "sparse" / "0")
    sandbox.write_binary_model(box.scan / "sparse" / "0", names_of(box)[0].encode(), 2_000_000_000, 400, 2, (480., 200., 200., .1))
    box.forget("gaussian_renderer", "image_undistorter")
    return Want(1, ("2000000000 x 400",)), renderer(box), {}


def wide_database_camera(box):
    write_database(box.scan / "database.db", names_of(box), width=2_000_000_000)
    return Want(1, ("width",)), splitter(box), {}


def focal_in_database(box):
    write_database(box.scan / "database.db", names_of(box), focal=1e300)
    return Want(1, ("focal length",)), splitter(box), {}


def far_translation(box):
    box.use_workspace()
    path = box.scan / "sparse" / "0" / "images.txt"
    lines = path.read_text().splitlines()
    words = lines[0].split()
    words[5] = "1e300"
    lines[0] = " ".join(words)
    path.write_text("\n".join(lines) + "\n")
    box.forget("gaussian_trainer")
    return Want(1, ("1e12",)), trainer(box), {}


def edit_turntable(change, want, name):
    def prepare(box):
        box.use_workspace()
        data = json.loads((box.scan / "turntable.json").read_text())
        change(data)
        (box.scan / "turntable.json").write_text(json.dumps(data))
        box.forget("gaussian_trainer")
        return want, trainer(box), {}
    return Case("numbers", name, prepare)


def half_of_the_model(box):
    """Cut off between two images: nothing in the file shows that there were more."""
    box.use_workspace()
    path = box.scan / "sparse" / "0" / "images.txt"
    path.write_text("\n".join(path.read_text().splitlines()[:8]) + "\n")
    box.forget("gaussian_trainer")
    return Want(0, ("4 images of .*turntable.json have no pose",)), trainer(box), {}


def no_images(data):
    data["images"] = []


def other_angles(data):
    for i, image in enumerate(data["images"]):
        image["angle_deg"] = 77.0 * i


# --- Dead ends -----------------------------------------------------------------------------------------------------------

def damaged_checkpoint(content, name):
    def prepare(box):
        box.use_workspace()
        checkpoint = box.scan / "s2gs" / "checkpoints" / "latest.checkpoint"
        checkpoint.parent.mkdir(parents=True, exist_ok=True)
        checkpoint.write_bytes(content)
        box.forget("gaussian_trainer")

        def then(box, run):
            aside = checkpoint.parent / "latest.checkpoint.damaged"
            is_aside = aside.exists() and aside.read_bytes() == content
            return [] if is_aside else ["the damaged checkpoint is gone"]
        return Want(0, ("checkpoint cannot be read", "starts anew"), then=then), trainer(box), {}
    return Case("dead ends", name, prepare)


def colmap_dies(script, says, name, interrupt_after=None, code=1, **options):
    def prepare(box):
        colmap = sandbox.fake_colmap(box.folder / "colmap", script, **options)
        return (Want(code, says, ("has no option",)), scanner(box, colmap=colmap),
                {"interrupt_after": interrupt_after} if interrupt_after else {})
    return Case("dead ends", name, prepare)


def two_photos_in_splitter(box):
    write_database(box.scan / "database.db", names_of(box)[:2])
    return Want(1, ("2 images", "more photos"), ("feature_extractor",)), splitter(box), {}


def small_file_limit(box):
    return (Want(1, ("ulimit -f",), then=lambda box, run: no_workspace(box)), scanner(box), {"file_limit": 100_000})


def noise_photos(box):
    random = np.random.default_rng(3)
    for name in names_of(box):
        cv2.imwrite(str(box.photos / name), random.integers(0, 255, (400, 400, 3), dtype=np.uint8))
    if shutil.which("colmap") is None:
        raise CannotRun("no colmap here")
    return (Want(1, ("in common|too little texture",), ("more photos with smaller steps may help",), max_cpu_seconds=300),
            scanner(box, "--until", "split", colmap=shutil.which("colmap")), {})


def nothing_turns(box):
    picture = cv2.imread(str(box.photos / names_of(box)[0]))
    random = np.random.default_rng(3)
    for name in names_of(box):
        noisy = np.clip(picture + random.normal(0, 2, picture.shape), 0, 255).astype(np.uint8)
        cv2.imwrite(str(box.photos / name), noisy)
    if shutil.which("colmap") is None:
        raise CannotRun("no colmap here")
    return (Want(1, (r"error: [^\n]*(stands still|nothing in them turns)",), max_cpu_seconds=300),
            scanner(box, "--until", "split", colmap=shutil.which("colmap")), {})


# --- Stale and read-only -------------------------------------------------------------------------------------------------

def photo_taken_out(box):
    box.use_workspace()
    gone = names_of(box)[-1]
    path = box.scan / "sparse" / "0" / "images.txt"
    lines = path.read_text().splitlines()
    keep = [line for i in range(0, len(lines), 2) for line in lines[i:i + 2] if not lines[i].endswith(gone)]
    path.write_text("\n".join(keep) + "\n")
    data = json.loads((box.scan / "turntable.json").read_text())
    data["images"] = [image for image in data["images"] if image["name"] != gone]
    (box.scan / "turntable.json").write_text(json.dumps(data))
    own = box.scan / "masks" / "mine.png"
    own.write_bytes(b"mine")

    def then(box, run):
        left = [str(p.relative_to(box.scan)) for p in box.scan.rglob("*") if gone in p.name]
        return ([f"still there: {left}"] if left else []) + ([] if own.exists() else ["a file of the user's is gone"])
    return Want(0, ("no longer there", "mine.png"), then=then), renderer(box), {}


def read_only(command):
    def prepare(box):
        if os.geteuid() != 0:
            raise CannotRun("needs root, to run as nobody")
        box.use_workspace()
        for folder in [box.scan, *(p for p in box.scan.rglob("*") if p.is_dir())]:
            folder.chmod(0o555)
        for path in box.scan.rglob("*"):
            if path.is_file():
                path.chmod(0o444)
        # As the workspace was made.
        arguments = ["gaussian_renderer", "--workspace_path", box.scan, "--image_path", box.base / "photos", "--use_gpu", "0"]
        if command == "trainer":
            arguments = ["gaussian_trainer", "--workspace_path", box.scan, "--image_path", box.base / "photos", "--use_gpu", "0",
                         "--Train.num_iterations", "40", "--max_image_size", "96", "--Init.num_random_points", "2000",
                         "--Init.min_points", "1000"]
        return Want(0, ("up to date",)), arguments, {"user": NOBODY}
    return Case("places", f"read-only, {command}", prepare)


# --- Environment, signals, disk ------------------------------------------------------------------------------------------

def environment(changes, want, name):
    def prepare(box):
        box.use_workspace()
        box.forget("gaussian_trainer")
        return want, trainer(box), {"env": changes}
    return Case("environment", name, prepare)


def no_colmap(box):
    arguments = ["automatic_scanner", "--workspace_path", box.scan, "--image_path", box.photos]
    return Want(1, ("colmap: is not on PATH",), then=lambda box, run: no_workspace(box)), arguments, {"env": {"PATH": "/nowhere"}}


def interrupted(box):
    box.use_workspace()
    box.forget("gaussian_trainer")
    arguments = trainer(box)
    arguments[arguments.index("--Train.num_iterations") + 1] = "1000000"
    return Want(130, ("stopped as asked",), max_cpu_seconds=60), arguments, {"interrupt_after": 2}


def full_disk(box):
    box.use_workspace()
    box.forget("gaussian_trainer")
    return Want(1, ("ulimit -f|space",)), trainer(box), {"file_limit": 4096}


def full_output(box):
    box.use_workspace()
    return Want(1, ("standard output",)), renderer(box), {"stdout": open("/dev/full", "wb")}


# --- All -----------------------------------------------------------------------------------------------------------------

def short_cases():
    for reader, which in [("sparse/0", "absolute"), ("sparse/static", "leads out"), ("turntable.json", "absolute"),
                          ("database", "absolute"), ("dense/0/sparse", "leads out later"), ("labels.json", "leads out"),
                          ("images.bin", "not UTF-8"), ("images.bin", "escape")]:
        yield name_in(reader, which)
    yield Case("names", "the same photos under other names", names_in_another_order)
    yield Case("names", "masks are a link out of the workspace", link_out)
    yield Case("names", "a mask is a link to a photo", link_to_photo)
    yield Case("names", "photos in dense/0/images", photos_in_dense)
    yield Case("links", "split leads out", split_leads_out)
    yield Case("links", "sparse leads out, turntable_mapper", mapper_into_a_link)
    yield Case("links", "the lock is a link to a photo", lock_is_a_photo)
    yield Case("links", "a scan in a workspace of links", scan_with_links)
    yield link_in_the_workspace("s2gs/lock", trainer)
    yield link_in_the_workspace("report.html", lambda box: ["report", "--workspace_path", box.scan, "--image_path", box.photos])
    yield link_in_the_workspace("s2gs/plan.json", lambda box: ["scan_planner", "--workspace_path", box.scan, "--image_path", box.photos])
    yield Case("links", "imported photos behind a link are photos", import_through_a_link)
    yield Case("photos", "importing into the photos", import_into_the_photos)
    yield Case("photos", "importing what was imported", import_what_was_imported)
    yield Case("photos", "importing from a folder without photos", import_nothing)
    yield Case("photos", "a TIFF of 65,535 equal tags", tiff_of_many_tags)
    for kind, place, says, make in [("splat_set", the_workspace, ("which the workspace needs",), None),
                                    ("splat_set", other_pictures, ("is not written over",), make_other_pictures),
                                    ("photos_alpha", the_photos, ("which the workspace needs",), None),
                                    ("metashape", a_photo, ("lies in",), None),
                                    ("metashape", turntable_json, ("which the workspace needs",), None),
                                    ("splat_glb", other_pictures, ("ends in .glb",), make_other_pictures)]:
        yield exported_over(kind, place, says, make)
    yield Case("exports", "a plan over a photo", plan_over_a_photo)
    yield Case("batch", "a page of others", batch_over_a_page)
    yield Case("batch", "a workspace among photos", batch_among_photos)
    yield Case("batch", "1000 objects", batch_of_many)
    yield Case("options", "angles of 8 GB", endless_angles)
    yield scanner_option("--num_iterations", "0", ("--num_iterations 0 violates",))
    yield scanner_option("--num_iterations", "-1", ("--num_iterations -1 violates",))
    yield scanner_option("--use_gpu", "yes", ("--use_gpu yes is none of",))
    yield scanner_option("--use_gpu", "2", ("--use_gpu 2 is none of",))
    yield scanner_option("--test_every", "1", ("--test_every 1 violates",))
    yield scanner_option("--max_image_size", "5", ("--max_image_size 5 violates",))
    if not pathlib.Path("/dev/nvidia0").exists():
        yield scanner_option("--use_gpu", "1", ("no GPU can be used",), code=1)
    yield scanner_option("--mask_path", "/nowhere", ("/nowhere: there is no such folder of masks",), code=1)
    yield Case("options", "all faults at once", all_at_once)
    yield Case("options", "masks for half of the photos", half_masks)
    yield Case("options", "a mask of another size", small_mask)
    yield Case("options", "tsdf_mesher into a missing folder", mesh_into_nowhere)
    yield tsdf_memory("1e308")
    yield with_photo("TIFF, BMP, WebP, HEIC", foreign_formats, ("x.tif", "x.bmp", "x.webp", "under the same name", "y.HEIC", "ends before"))
    yield Case("photos", "hidden files of macOS", hidden_files_pass)
    yield with_photo("raw beside JPEG", raw_beside_jpeg, ("left alone", "feature_extractor failed"), not_says=())
    for name, shown in [(b"a\nb.jpg", "control character"), (b"a\tb.jpg", "control character"), (b" a.jpg", "space"),
                        (b"a\\b.jpg", "backslash"), (b"\xff.jpg", "UTF-8"), (b"\x1b[2Jx.jpg", "control character")]:
        yield with_photo(f"name {name!r}", rename_first(name), (shown, "rename"))
    yield with_photo("empty file", lambda box: (box.photos / "x.jpg").write_bytes(b""), ("x.jpg: is empty",))
    yield with_photo("no picture", lambda box: (box.photos / "x.jpg").write_bytes(b"hello" * 9), ("x.jpg: is neither",))
    yield with_photo("cut-off JPEG", cut_photo, ("ends before its pixels do",))
    yield with_photo("cut-off PNG", cut_png, ("x.png: ends before its pixels do",))
    yield with_photo("names that differ in case", differ_in_case, ("in case alone",))
    yield with_photo("one photo", keep_photos(1), ("1 photo only", "at least 3"))
    yield with_photo("two photos", keep_photos(2), ("2 photos only",))
    yield with_photo("no photo", keep_photos(0), ("has no photos",))
    yield with_photo("identical photos", identical_photos, ("copies of a single one",))
    yield with_photo("64 megapixels of one colour", lambda box: write_flat_png(box.photos / "x.png", 8200), ("no photo fits",))
    yield with_photo("broken link", broken_link, ("x.jpg: is a link that leads nowhere",))
    yield with_photo("link to a folder", linked_folder, ("station2: is a link to a folder",))
    yield with_photo("pipe", pipe, ("x.jpg: is no regular file",))
    yield Case("photos", "workspace in the photos' folder", workspace_in_photos)
    yield camera("1 SIMPLE_RADIAL 2000000000 400 480 200 200 0.1", ("2000000000",), "camera of 2e9 pixels with distortion")
    yield Case("numbers", "binary camera of 2e9 pixels", wide_binary_camera)
    yield Case("numbers", "database camera of 2e9 pixels", wide_database_camera)
    yield Case("numbers", "focal length 1e300 in a database", focal_in_database)
    yield camera("1 PINHOLE 400 400 1e300 1e300 200 200", ("focal length",), "focal length 1e300")
    yield Case("numbers", "translation 1e300", far_translation)
    yield Case("numbers", "half of the images of a model", half_of_the_model)
    yield edit_turntable(no_images, Want(1, ("images is empty",)), "turntable.json without images")
    yield edit_turntable(other_angles, Want(0, ("contradict",)), "turntable.json contradicts itself")
    yield damaged_checkpoint(b"S2GSCKPT\1\0\0\0", "truncated checkpoint")
    yield damaged_checkpoint(b"garbage", "damaged checkpoint")
    yield report_of_wrong_kinds('{"observability": {"computed": "x"}}')
    yield colmap_dies("exit 0", ("cannot be asked for the options of feature_extractor",), "colmap without options")
    yield colmap_dies("kill -SEGV $$", ("cannot be asked for the options", "signal 11"), "colmap crashes in -h")
    yield colmap_dies("@OPTIONS@\nprintf 'bad \\033[2Jnews\\n'; kill -ABRT $$", ("ended by signal 6", r"bad \\x1b"),
                      "colmap crashes in its extractor")
    yield colmap_dies("", ("does not answer",), "colmap crashes at once", help_text=False)
    yield colmap_dies("@OPTIONS@\nsleep 1000", ("stopped as asked",), "colmap hangs, Ctrl-C", interrupt_after=4, code=130)
    yield Case("dead ends", "two photos in a database", two_photos_in_splitter)
    yield Case("dead ends", "file limit below the features", small_file_limit)
    yield Case("places", "a photo is taken out", photo_taken_out)
    yield read_only("renderer")
    yield read_only("trainer")
    yield Case("environment", "no colmap", no_colmap)
    yield environment({"HOME": None, "TERM": None, "TMPDIR": "/nowhere"}, Want(0), "no home, terminal, temporary folder")
    yield environment({"LC_ALL": "tr_TR.UTF-8", "LANG": "de_DE.UTF-8"}, Want(0), "another locale")
    yield Case("signals", "Ctrl-C in training", interrupted)
    yield Case("disk", "file limit in training", full_disk)
    yield Case("disk", "standard output is full", full_output)


def damaged(path, fraction, flip):
    """A file of the workspace cut off, or with a bit flipped, at a fraction of its length."""
    def prepare(box):
        box.use_workspace()
        file = box.scan / path
        if not file.exists():
            raise CannotRun("the workspace has no such file")
        data = bytearray(file.read_bytes())
        at = min(int(fraction * len(data)), len(data) - 1)
        if flip:
            data[at] ^= 0x40
        file.write_bytes(bytes(data if flip else data[:at]))
        box.forget("gaussian_trainer", "gaussian_renderer", "image_undistorter")
        return Want(None), (renderer(box) if "dense" in path or "ply" in path else trainer(box)), {}
    return Case("damage", f"{path} {'flipped' if flip else 'cut'} at {fraction}", prepare)


WORKSPACE_FILES = ["sparse/0/cameras.txt", "sparse/0/images.txt", "sparse/static/images.txt", "turntable.json",
                   "s2gs/point_cloud.ply", "s2gs/stages/gaussian_trainer.json", "s2gs/stages/gaussian_renderer.json",
                   "s2gs/stages/image_undistorter.json", "dense/0/sparse/images.bin", "dense/0/sparse/cameras.bin"]
OPTION_VALUES = ["-1", "0", "1e308", "nan", "inf", "", "yes", "99999999999999999999", "1e-320", "0x10", "1,5", "\x1b[2J"]


def option_case(command, option, value):
    def prepare(box):
        commands = subprocess.run([box.program, "help"], capture_output=True, text=True).stdout
        if f"\n  {command} " not in commands:
            raise CannotRun("no such command")
        where = {"motion_splitter": ["--database_path", box.scan / "none.db"], "scan_batch": ["--list", box.scan / "none.csv"],
                 "marker_sheet": ["--output_path", box.scan / "none.txt"],
                 "photo_importer": ["--workspace_path", box.scan, "--image_path", box.scan / "none"]}
        where = where.get(command, ["--workspace_path", box.scan])
        return Want(None, not_says=("unknown option",), needs_message=False), [command, *where, f"--{option}", value], {}
    return Case("options", f"{command} --{option} {value!r}", prepare)


NUMERIC_OPTIONS = {"gaussian_trainer": ["Train.num_iterations", "Train.max_seconds", "max_image_size", "test_every",
                                        "Train.max_gaussians", "num_threads", "gpu_index", "Init.max_points"],
                   "gaussian_renderer": ["num_frames", "frame_station", "num_threads"],
                   "tsdf_mesher": ["Tsdf.voxel_size", "Tsdf.max_memory_gib", "Tsdf.max_resolution", "Tsdf.num_threads",
                                   "Cleanup.max_triangles", "Refine.max_memory_gib"],
                   "motion_splitter": ["max_overlays", "SiftExtraction.max_num_features", "Station.max_unmoved_px",
                                       "TwoViewMotion.max_error_px", "Split.max_exhaustive_pairs"],
                   "turntable_mapper": ["max_mapper_attempts", "Joint.max_iterations", "Joint.function_tolerance"],
                   "photo_importer": ["video_frames"],
                   "scan_batch": ["jobs", "rows", "gpus"],
                   "model_scaler": ["marker_size_mm", "known_length_mm", "disc_diameter_mm", "charuco_columns"],
                   "mesh_texturer": ["Texture.max_page_size", "Texture.texel_size_pixels", "test_every"],
                   "marker_sheet": ["diameter_mm", "marker_size_mm", "first_id"],
                   "automatic_scanner": ["test_every", "num_iterations", "max_image_size", "random_seed"],
                   "scan_evaluator": ["random_seed"]}


def deep_json(path):
    def prepare(box):
        box.use_workspace()
        target = box.scan / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text("[" * 1_000_000)
        if "stages" not in path:
            box.forget("gaussian_trainer")
        return Want(None), trainer(box), {}
    return Case("damage", f"{path} nested a million times", prepare)


MAX_CPU_AFTER_INTERRUPT = 10  # seconds of two threads together: five of an idle machine


def heard_soon(box, run):
    if run.cpu_after_interrupt is None or run.cpu_after_interrupt < MAX_CPU_AFTER_INTERRUPT:
        return []
    return [f"heard Ctrl-C after {run.cpu_after_interrupt:.0f} s of CPU"]


def large_photos(box, camera):
    """Photos of 67 megapixels in place of all. `camera`: COLMAP's model and numbers for a side of {0} pixels."""
    box.use_workspace()
    names = names_of(box)
    side = 8192
    write_flat_png(box.photos / names[0], side)
    for name in names[1:]:
        shutil.copyfile(box.photos / names[0], box.photos / name)
    (box.scan / "sparse" / "0" / "cameras.txt").write_text(f"1 {camera.format(side, side / 2)}\n")


def interrupted_in_a_photo(box):
    """Behind a lens; Ctrl-C comes while their pixels are moved."""
    large_photos(box, "FULL_OPENCV {0} {0} {0} {0} {1} {1} .05 0 0 0 0 0 0 0")
    box.forget("gaussian_renderer", "image_undistorter")
    shutil.rmtree(box.scan / "dense")
    want = Want(130, ("stopped as asked",), then=heard_soon, max_cpu_seconds=60)
    return want, renderer(box), {"interrupt_at_cpu": 4}


def interrupted_in_a_rendering(at_cpu):
    def prepare(box):
        """Without distortion; Ctrl-C comes while room is made for one of them, or while it is drawn."""
        large_photos(box, "PINHOLE {0} {0} {0} {0} {1} {1}")
        box.forget("gaussian_renderer")
        want = Want(130, ("stopped as asked",), then=heard_soon, max_cpu_seconds=60)
        return want, renderer(box, "--stereo", "0"), {"interrupt_at_cpu": at_cpu}
    return prepare


def report_of_wrong_kinds(content):
    def prepare(box):
        box.use_workspace()
        (box.scan / "split").mkdir(exist_ok=True)
        (box.scan / "split" / "turntable_mapper.json").write_text(content)
        return (Want(0, ("of the report is left out",)),
                ["report", "--workspace_path", box.scan, "--image_path", box.photos], {})
    return Case("damage", f"report of {content}", prepare)


def silent_colmap(box):
    colmap = sandbox.fake_colmap(box.folder / "colmap", "@OPTIONS@\nsleep 1000")
    return (Want(130, ("has printed nothing for 6[0-9] seconds", "Ctrl-C")), scanner(box, colmap=colmap), {"interrupt_after": 64})


def full_cases():
    for reader in READERS:
        for which in NAMES:
            if reader not in ("sparse/0", "sparse/static") or which not in ("long",):
                yield name_in(reader, which)
    for path in WORKSPACE_FILES:
        for fraction in (0, 0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99):
            for flip in (False, True):
                yield damaged(path, fraction, flip)
    for command, options in NUMERIC_OPTIONS.items():
        for option in options:
            for value in OPTION_VALUES:
                yield option_case(command, option, value)
    for path in ("turntable.json", "s2gs/stages/gaussian_trainer.json", "s2gs/stages/turntable_mapper.json"):
        yield deep_json(path)
    for content in ('{"joint_model": {"chosen": 5, "tests": {"a": 1}}}', '{"sigma": {"focal_px": "x"}, "rounds": [7], "mended": [7]}'):
        yield report_of_wrong_kinds(content)
    for value in ("0", "-1", "nan", "inf", "1e300"):
        yield tsdf_memory(value)
    yield with_photo("268 megapixels of one colour", lambda box: write_flat_png(box.photos / "x.png", 16384), ("no photo fits",))
    yield Case("signals", "Ctrl-C in the undistortion of one photo", interrupted_in_a_photo)
    for at_cpu in (1, 4):
        yield Case("signals", f"Ctrl-C in the rendering of one photo after {at_cpu} s", interrupted_in_a_rendering(at_cpu))
    yield Case("dead ends", "photos of noise", noise_photos)
    yield Case("dead ends", "nothing turns", nothing_turns)
    yield Case("dead ends", "colmap is silent for a minute", silent_colmap)


def all_cases(full):
    yield from short_cases()
    if full:
        yield from full_cases()
