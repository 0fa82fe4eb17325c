#!/usr/bin/env python3
"""Thins the rotating keypoints' matches of a split workspace at random, as an object with less texture would have.

usage: thin_database.py WORKSPACE OUTPUT_WORKSPACE SCENE SHARE [SEED]

Copies WORKSPACE/split to OUTPUT_WORKSPACE/split. Of the keypoints that SCENE/gt/masks call object or disc, SHARE (0 to
1) keep their verified matches in object.db; the others lose theirs. Needs numpy and OpenCV's Python module.
"""
import json, os, shutil, sqlite3, sys

import cv2
import numpy as np

workspace, output, scene, share = sys.argv[1:4] + [float(sys.argv[4])]
rng = np.random.default_rng(int(sys.argv[5]) if len(sys.argv) > 5 else 0)
os.makedirs(os.path.join(output, 'split'), exist_ok=True)
for name in ('labels.json', 'static.db', 'object.db'):
    shutil.copy(os.path.join(workspace, 'split', name), os.path.join(output, 'split', name))

database = sqlite3.connect(os.path.join(output, 'split', 'object.db'))
kept = {}
for image_id, name, rows, cols, data in database.execute(
        'select images.image_id, name, rows, cols, data from images join keypoints using (image_id)').fetchall():
    xy = np.frombuffer(data, np.float32).reshape(rows, cols)[:, :2].astype(int)
    mask = cv2.imread(os.path.join(scene, 'gt', 'masks', os.path.splitext(name)[0] + '.png'), cv2.IMREAD_GRAYSCALE)
    y, x = np.clip(xy[:, 1], 0, mask.shape[0] - 1), np.clip(xy[:, 0], 0, mask.shape[1] - 1)
    kept[image_id] = (mask[y, x] == 0) | (rng.random(rows) < share)

for pair_id, rows, data in database.execute(
        'select pair_id, rows, data from two_view_geometries where rows > 0').fetchall():
    second = pair_id % 2147483647
    first = (pair_id - second) // 2147483647
    matches = np.frombuffer(data, np.uint32).reshape(rows, 2)
    matches = matches[kept[first][matches[:, 0]] & kept[second][matches[:, 1]]]
    if len(matches) == 0:
        database.execute('delete from two_view_geometries where pair_id = ?', (pair_id,))
    else:
        database.execute('update two_view_geometries set rows = ?, data = ? where pair_id = ?',
                         (len(matches), matches.tobytes(), pair_id))
database.commit()
count = database.execute('select count(*), sum(rows) from two_view_geometries').fetchone()
print(f'{share:.2f} of the rotating keypoints keep their matches: {count[0]} pairs, {count[1]} matches')
