#!/usr/bin/env python3
"""Thins the rotating part of a split workspace at random, as an object and a disc with less texture would have it.

usage: thin_database.py WORKSPACE OUTPUT_WORKSPACE SHARE [SEED]

Copies WORKSPACE/split to OUTPUT_WORKSPACE/split. Of the keypoints in object.db SHARE (0 to 1) keep their matches,
raw and verified, so that about SHARE squared of them stay; the share of wrong ones stays as it was. Needs numpy.
"""
import os, shutil, sqlite3, sys

import numpy as np

workspace, output, share = sys.argv[1], sys.argv[2], float(sys.argv[3])
rng = np.random.default_rng(int(sys.argv[4]) if len(sys.argv) > 4 else 0)
os.makedirs(os.path.join(output, 'split'), exist_ok=True)
for name in ('labels.json', 'static.db', 'object.db'):
    shutil.copy(os.path.join(workspace, 'split', name), os.path.join(output, 'split', name))

database = sqlite3.connect(os.path.join(output, 'split', 'object.db'))
kept = {image_id: rng.random(rows) < share
        for image_id, rows in database.execute('select image_id, rows from keypoints').fetchall()}
for table in ('two_view_geometries', 'matches'):
    for pair_id, rows, data in database.execute(
            f'select pair_id, rows, data from {table} where rows > 0').fetchall():
        second = pair_id % 2147483647
        first = (pair_id - second) // 2147483647
        matches = np.frombuffer(data, np.uint32).reshape(rows, 2)
        matches = matches[kept[first][matches[:, 0]] & kept[second][matches[:, 1]]]
        if len(matches) == 0:
            database.execute(f'delete from {table} where pair_id = ?', (pair_id,))
        else:
            database.execute(f'update {table} set rows = ?, data = ? where pair_id = ?',
                             (len(matches), matches.tobytes(), pair_id))
database.commit()
count = database.execute('select count(*), sum(rows) from two_view_geometries').fetchone()
print(f'{share:.2f} of the keypoints keep their matches: {count[0]} pairs, {count[1]} matches')
