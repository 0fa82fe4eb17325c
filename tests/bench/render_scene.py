#!/usr/bin/env python3
"""Renders a turntable scan with exact ground truth: photos, masks, poses and surfaces of a made-up object and room.

usage: render_scene.py OUTPUT_FOLDER [--object vase|knot|rock|box|group] [options]

Everything is made from the seed: a displaced, lathed, knotted or assembled object with a solid or printed texture on a
disc that turns, a room with pictures on its walls and things on its desk, lights that stand still (so that shadows and
shading move over the object, the disc and the desk), ambient occlusion, sensor noise and JPEG. What real captures have
can be asked for: exposure and white balance that jump, a plate that wobbles, hands and people, a lens that is open, dark
in its corners or focused anew for each photo, a tripod that shakes. Written are images/,
images_test/ (held-out angles), gt/masks/NAME.png (255 object, 128 disc, 0 static), gt/object.ply, gt/disc.ply and
gt/scene.json, as `s2gs scan_evaluator` reads them. Units are metres.

Needs numpy, scipy, Pillow and open3d (`pip install open3d scipy pillow`).
"""
import argparse, json, os
import numpy as np
import open3d as o3d
from PIL import Image, ImageDraw
from scipy.ndimage import gaussian_filter, map_coordinates, zoom

DISC_RADIUS, DISC_BOTTOM, DISC_TOP = 0.145, 0.014, 0.032
AXIS = np.array([0.03, 0.02, DISC_TOP])
LIGHTS = np.array([[0.9, -1.0, 1.9], [1.05, -0.9, 1.9], [0.9, -0.85, 1.95], [1.05, -1.05, 1.85]])


# ---- textures: functions of points and normals in a body's own frame ----

def noise_volume(rng, octaves=(4, 8, 16, 32, 64), side=128):
    """Periodic noise of three channels, zero mean and unit deviation, side x side x side x 3."""
    out = np.zeros((3, side, side, side), np.float32)
    for channel in range(3):
        for octave in octaves:
            grid = rng.standard_normal((octave,) * 3).astype(np.float32)
            out[channel] += zoom(grid, side / octave, order=1, mode='grid-wrap', grid_mode=True) * octave ** -0.35
        out[channel] /= out[channel].std()
    return out


def noise_texture(volume, base, strength, tile):
    """Colours of a solid: noise that repeats every `tile` metres."""
    base = np.asarray(base, np.float32)

    def colour(points, _):
        at = (points / tile * volume.shape[1]).T
        noise = np.stack([map_coordinates(c, at, order=1, mode='grid-wrap') for c in volume], 1)
        noise = 0.75 * noise[:, :1] + 0.5 * noise
        return base * np.clip(1 + strength * noise, 0.1, 2.2)
    return colour


def draw_picture(rng, pixels, busy):
    """A printed picture: washes, shapes, lines and words' strokes; linear colours, pixels x pixels x 3."""
    wash = np.stack([gaussian_filter(rng.standard_normal((pixels, pixels)), pixels / 14, mode='wrap') for _ in range(3)], 2)
    wash = 0.5 + 0.12 * wash / wash.std() + 0.25 * (rng.random(3) - 0.5)
    image = Image.fromarray((np.clip(wash, 0.05, 0.95) * 255).astype(np.uint8))
    draw = ImageDraw.Draw(image)
    for _ in range(busy):
        x, y, r = *(rng.random(2) * pixels), pixels * 0.004 * np.exp(2.6 * rng.random())
        ink, kind = tuple(int(v) for v in rng.integers(10, 245, 3)), rng.integers(5)
        if kind == 0:
            draw.ellipse([x - r, y - r, x + r, y + r * (0.5 + rng.random())], fill=ink)
        elif kind == 1:
            draw.rectangle([x - r, y - r * rng.random(), x + r * 2, y + r], fill=ink)
        elif kind == 2:
            draw.polygon([tuple(np.array([x, y]) + r * 1.6 * rng.standard_normal(2)) for _ in range(3)], fill=ink)
        elif kind == 3:
            end = np.array([x, y]) + 3 * r * rng.standard_normal(2)
            draw.line([x, y, *end], fill=ink, width=max(1, int(r / 4)))
        else:
            for k in range(int(rng.integers(4, 14))):
                left, height = x + k * r * 0.5, r * (0.5 + 0.7 * rng.random())
                draw.rectangle([left, y - height * rng.random(), left + r * 0.25, y + height * 0.4], fill=ink)
    return (np.asarray(image, np.float32) / 255) ** 2.2


def speckles(rng, pixels, count, base):
    image = Image.new('RGB', (pixels, pixels), tuple(int(255 * v ** (1 / 2.2)) for v in base))
    draw = ImageDraw.Draw(image)
    for x, y, s in zip(rng.random(count) * pixels, rng.random(count) * pixels, rng.random(count)):
        r = pixels * (0.003 + 0.009 * s * s)
        draw.polygon([(x + r * np.cos(a), y + r * np.sin(a)) for a in np.sort(rng.random(5) * 6.28)],
                     fill=tuple(int(v) for v in rng.integers(10, 245, 3)))
    return (np.asarray(image, np.float32) / 255) ** 2.2


def picture_texture(picture, centre, size):
    """A picture of `size` metres on each side of a body, repeated, laid flat along the axis nearest the normal."""
    def colour(points, normals):
        flat = np.array([[1, 2], [0, 2], [0, 1]])[np.abs(normals).argmax(1)]
        uv = np.take_along_axis(points - centre, flat, 1) / size + 0.5
        at = (uv * picture.shape[0] - 0.5).T
        return np.stack([map_coordinates(picture[:, :, c], at, order=1, mode='grid-wrap') for c in range(3)], 1)
    return colour


# ---- shapes: (vertices, triangles, whether its normals are smooth) ----

def grid_mesh(points, wrap_u, wrap_v):
    """A surface from an array of points u x v x 3."""
    nu, nv = points.shape[:2]
    u, v = np.meshgrid(np.arange(nu - (not wrap_u)), np.arange(nv - (not wrap_v)), indexing='ij')
    a, b = u * nv + v, (u + 1) % nu * nv + v
    c, d = (u + 1) % nu * nv + (v + 1) % nv, u * nv + (v + 1) % nv
    triangles = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return points.reshape(-1, 3), triangles, True


def box(centre, size, turn=0.0, cells=10):
    """An upright box; its faces are divided so that occlusion can be kept at the vertices."""
    vertices, triangles = [], []
    s, t = np.meshgrid(np.linspace(-0.5, 0.5, cells + 1), np.linspace(-0.5, 0.5, cells + 1), indexing='ij')
    for axis in range(3):
        for side in (-0.5, 0.5):
            face = np.stack([np.full_like(s, side), s, t] if side > 0 else [np.full_like(s, side), t, s], -1)
            v, f, _ = grid_mesh(np.roll(face, axis, -1), False, False)
            triangles.append(f + sum(map(len, vertices)))
            vertices.append(v)
    c, s = np.cos(turn), np.sin(turn)
    v = np.concatenate(vertices) * size
    return v @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + centre, np.concatenate(triangles), False


def ball(volume, radius, displacement, squash, rows=220):
    """A sphere displaced by smooth noise, on the plane z = 0."""
    theta, phi = np.linspace(1e-3, np.pi - 1e-3, rows), np.linspace(0, 2 * np.pi, 2 * rows, endpoint=False)
    t, p = np.meshgrid(theta, phi, indexing='ij')
    d = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], -1)
    r = np.ones_like(t)
    for scale, weight in ((5, 1), (11, 0.45), (27, 0.16)):
        at = (d.reshape(-1, 3) * scale + 40).T
        smooth = gaussian_filter(volume[0], 3, mode='wrap')
        r += displacement * weight * map_coordinates(smooth / smooth.std(), at, order=1, mode='grid-wrap').reshape(t.shape)
    v, f, smooth = grid_mesh(d * (np.maximum(r, 0.35) * radius)[..., None] * [1, 1, squash], False, True)
    return v - [0, 0, v[:, 2].min()], f, smooth


def knot(p, q, size, tube):
    s, t = np.meshgrid(np.linspace(0, 2 * np.pi, 900, endpoint=False), np.linspace(0, 2 * np.pi, 56, endpoint=False), indexing='ij')
    curve = lambda s: np.stack([(2 + np.cos(q * s)) * np.cos(p * s), (2 + np.cos(q * s)) * np.sin(p * s), 1.15 * np.sin(q * s)], -1)
    c = curve(s)
    along = curve(s + 1e-4) - curve(s - 1e-4)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    side = np.cross(along, c)
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    v = c + tube * (1 + 0.25 * np.sin(7 * s))[..., None] * (np.cos(t)[..., None] * side + np.sin(t)[..., None] * np.cross(along, side))
    v, f, smooth = grid_mesh(v[..., [0, 2, 1]] * size / 3, True, True)
    return v - [0, 0, v[:, 2].min()], f, smooth


def lathe(profile, segments=360):
    """A body of revolution about z from (radius, height) rows."""
    profile = np.asarray(profile, float)
    a = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    points = np.stack([profile[:, :1] * np.cos(a), profile[:, :1] * np.sin(a), profile[:, 1:] + 0 * a], -1)
    return grid_mesh(points[:, ::-1], False, True)


def vase(size):
    s = np.linspace(0, 1, 160)
    outer = 0.30 + 0.14 * np.sin(2.2 * np.pi * s + 0.3) + 0.02 * np.sin(40 * s)
    profile = np.concatenate([[[1e-4, 0]], np.stack([outer, s], 1), np.stack([outer[::-1] - 0.05, s[::-1]], 1)[:110]])
    v, f, _ = lathe(np.concatenate([profile, [[1e-4, profile[-1, 1]]]]) * size)
    handle = [knot(1, 0, size * 0.14, 0.25)[0], knot(1, 0, size * 0.14, 0.25)[1]]
    h = handle[0][:, [0, 2, 1]] if np.ptp(handle[0][:, 2]) < np.ptp(handle[0][:, 1]) else handle[0]
    h = h - h.mean(0) + [0.41 * size, 0, 0.55 * size]
    return np.concatenate([v, h]), np.concatenate([f, handle[1] + len(v)]), True


def make_object(kind, size, rng, volume):
    """Parts in the object's frame, the foot of the axis on the disc as origin."""
    if kind == 'vase':
        return [vase(size)]
    if kind == 'knot':
        return [knot(2, 3, size * 0.55, 0.5)]
    if kind == 'rock':
        return [ball(volume, size * 0.42, 0.16, 0.9)]
    if kind == 'box':
        sizes = size * np.array([[0.7, 0.5, 0.4], [0.36, 0.42, 0.35], [0.25, 0.2, 0.22]])
        feet = size * np.array([[0, 0, 0], [-0.12, 0.02, 0.4], [0.22, -0.08, 0.4]])
        return [box(f + [0, 0, s[2] / 2], s, turn, 24) for f, s, turn in zip(feet, sizes, (0.2, 0.6, -0.3))]
    parts = [vase(size * 0.62), ball(volume, size * 0.2, 0.2, 0.8), box(np.array([0, 0, 0.15]) * size, size * np.array([0.3, 0.24, 0.3]), 0.5, 24)]
    return [(v + np.array([x, y, 0]) * size, f, s) for (v, f, s), (x, y) in zip(parts, ((0.28, 0.1), (-0.3, 0.22), (-0.1, -0.33)))]


class Bodies:
    """Triangle meshes with textures that rays are cast at."""

    def __init__(self):
        self.scene, self.meshes = o3d.t.geometry.RaycastingScene(nthreads=1), []

    def add(self, mesh, texture, gloss=0.0, label=0):
        v, f, smooth = np.asarray(mesh[0], np.float32), np.asarray(mesh[1], np.uint32), mesh[2]
        face = np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]])
        normals = np.zeros_like(v)
        for corner in range(3):
            np.add.at(normals, f[:, corner], face)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
        self.scene.add_triangles(o3d.core.Tensor(v), o3d.core.Tensor(f))
        self.meshes.append(dict(v=v, f=f, smooth=smooth, normals=normals, texture=texture, gloss=gloss, label=label,
                                open=np.ones(len(v), np.float32)))

    def cast(self, origins, directions):
        rays = np.concatenate([origins, directions], 1).astype(np.float32)
        hit = self.scene.cast_rays(o3d.core.Tensor(rays), nthreads=1)
        return {k: hit[k].numpy() for k in ('t_hit', 'geometry_ids', 'primitive_ids', 'primitive_normals', 'primitive_uvs')}

    def blocked(self, origins, directions, far):
        rays = np.concatenate([origins, directions], 1).astype(np.float32)
        return self.scene.test_occlusions(o3d.core.Tensor(rays), 1e-4, float(far), nthreads=1).numpy()

    def surface(self, hit, points, directions):
        """Of hits: normals towards the ray, colours, openness to the sky, gloss and labels."""
        n, count = hit['primitive_normals'].astype(np.float64), len(points)
        colour, sky = np.zeros((count, 3), np.float32), np.zeros(count, np.float32)
        gloss, label = np.zeros(count, np.float32), np.zeros(count, np.uint8)
        for index, mesh in enumerate(self.meshes):
            on = np.nonzero(hit['geometry_ids'] == index)[0]
            if len(on) == 0:
                continue
            f, uv = mesh['f'][hit['primitive_ids'][on]], hit['primitive_uvs'][on]
            weights = np.stack([1 - uv.sum(1), uv[:, 0], uv[:, 1]], 1)
            if mesh['smooth']:
                n[on] = (mesh['normals'][f] * weights[..., None]).sum(1)
            n[on] /= np.linalg.norm(n[on], axis=1, keepdims=True) + 1e-12
            colour[on] = mesh['texture'](points[on], n[on])
            sky[on] = (mesh['open'][f] * weights).sum(1)
            gloss[on], label[on] = mesh['gloss'], mesh['label']
        n *= -np.sign((n * directions).sum(1, keepdims=True))
        return n, colour, sky, gloss, label


def keep_occlusion(bodies, others, rng, rays=32, far=0.35):
    """At each vertex the share of the sky that is open, of bodies that stand as at angle zero."""
    for mesh in bodies.meshes:
        for start in range(0, len(mesh['v']), 40000):
            at = slice(start, start + 40000)
            v, n = mesh['v'][at], mesh['normals'][at]
            d = rng.standard_normal((rays, len(v), 3)).astype(np.float32)
            d = n + d / np.linalg.norm(d, axis=2, keepdims=True) * 0.999
            origins = np.broadcast_to(v + 2e-4 * n, d.shape).reshape(-1, 3)
            hidden = sum(group.blocked(origins, d.reshape(-1, 3), far) for group in (bodies, *others)) > 0
            mesh['open'][at] = 1 - hidden.reshape(rays, -1).mean(0)


# ---- the scene ----

def look_at(eye, target, roll):
    z = target - eye
    z /= np.linalg.norm(z)
    x = np.cross(z, [0, 0, 1])
    x /= np.linalg.norm(x)
    x, y = np.cos(roll) * x + np.sin(roll) * np.cross(z, x), None
    y = np.cross(z, x)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([x, y, z])
    pose[:3, 3] = -pose[:3, :3] @ eye
    return pose


def turn_about_axis(degrees):
    a, pose = np.radians(degrees), np.eye(4)
    pose[:2, :2] = [[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]
    pose[:3, 3] = AXIS - pose[:3, :3] @ AXIS
    return pose


def build_room(options, rng, volume, cameras, reach):
    """Desk, walls and things on the desk that hide the disc from no camera."""
    room = Bodies()
    half = max(1.4, 1.25 * reach)
    busy = {'cluttered': 900, 'bright': 900, 'weak': 25, 'plain': 0}[options.background]
    pale = lambda texture: lambda p, n: 0.5 + 0.5 * texture(p, n) if options.background == 'bright' else texture(p, n)
    grey = np.full((8, 8, 3), 0.45, np.float32)
    for centre, size in (([0, 0, -0.02], [2 * half, 2 * half, 0.04]), ([0, half, 1], [2 * half, 0.04, 2.4]),
                         ([0, -half, 1], [2 * half, 0.04, 2.4]), ([half, 0, 1], [0.04, 2 * half, 2.4]),
                         ([-half, 0, 1], [0.04, 2 * half, 2.4]), ([0, 0, 2.2], [2 * half, 2 * half, 0.04])):
        picture = draw_picture(rng, 1536, busy) if busy else grey
        room.add(box(np.array(centre, float), np.array(size), 0, 40), pale(picture_texture(picture, np.array(centre), 1.6)))
    target, things = AXIS + [0, 0, 0.06], 0
    for _ in range(600 if options.background in ('cluttered', 'bright') else 0):
        radius, angle = 0.2 + 0.9 * half * rng.random() * 0.8, rng.random() * 2 * np.pi
        size = (0.04 + 0.11 * rng.random(3)) * (1 + radius)
        centre = np.array([radius * np.cos(angle), radius * np.sin(angle), 0]) + AXIS * [1, 1, 0]
        bound = 0.6 * np.linalg.norm(size)
        if radius < DISC_RADIUS + bound:
            continue
        middle, clear = centre + [0, 0, size[2] / 2], True
        for eye in cameras:
            along = np.clip((middle - eye) @ (target - eye) / ((target - eye) @ (target - eye)), 0, 1)
            clear &= np.linalg.norm(eye + along * (target - eye) - middle) > bound + 0.03 + DISC_RADIUS * along
        if not clear:
            continue
        base, kind = 0.15 + 0.6 * rng.random(3), rng.integers(3)
        texture = noise_texture(volume, base, 0.5, 0.1 + 0.15 * rng.random())
        if kind == 0:
            v, f, s = ball(volume, size[0] * 0.5, 0.02, 1, 40)
            room.add((v + centre, f, s), pale(texture))
        else:
            if kind == 1:
                texture = picture_texture(draw_picture(rng, 256, 60), middle, size.max())
            room.add(box(middle, size, rng.random() * 3), pale(texture))
        things += 1
        if things == options.things:
            break
    return room


def primary_rays(camera, pose, n):
    """Origins, directions and light numbers of n x n rays a pixel and, last, of the pixels' centres."""
    width, height, focal, k1 = camera
    offsets = (np.arange(n) + 0.5) / n
    sub = np.stack(np.meshgrid(offsets, offsets), -1).reshape(-1, 2)
    sub = np.concatenate([sub, [[0.5, 0.5]]])
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    xy = (np.stack([x, y], -1)[None] + sub[:, None, None] - [width / 2, height / 2]) / focal
    radius = np.linalg.norm(xy, axis=-1, keepdims=True)
    straight = radius.copy()
    for _ in range(30 if k1 else 0):
        straight -= (straight * (1 + k1 * straight ** 2) - radius) / (1 + 3 * k1 * straight ** 2)
    xy = xy * straight / np.maximum(radius, 1e-12)
    d = np.concatenate([xy, np.ones_like(radius)], -1).reshape(-1, 3) @ pose[:3, :3]
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    lights = np.repeat(np.arange(len(sub)) % len(LIGHTS), width * height)
    return np.broadcast_to(-pose[:3, :3].T @ pose[:3, 3], d.shape), d, lights


def shade(surface, directions, to_light):
    """Colours in the shade and in the light."""
    normal, colour, sky, gloss, _ = surface
    distance = np.linalg.norm(to_light, axis=1)
    light = to_light / distance[:, None]
    lit = np.clip((normal * light).sum(1), 0, None) * (4.2 / (0.4 + distance ** 2))
    half = light - directions
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    shine = gloss * np.clip((normal * half).sum(1), 0, 1) ** 40
    warm = np.array([1, 0.97, 0.92])
    return colour * (0.42 * sky)[:, None] * warm, colour * (0.42 * sky + lit)[:, None] * warm + shine[:, None]


def may_meet(origins, directions, centre, radius):
    along = np.maximum(((centre - origins) * directions).sum(1) / (directions ** 2).sum(1), 0)
    return np.linalg.norm(origins + along[:, None] * directions - centre, axis=1) < radius


def render(camera, pose, turn, room, table, bound, cache, options):
    """One noiseless linear picture, its labels and distances; what stands still is kept in the cache for the next."""
    width, height = camera[:2]
    if not cache:
        o, d, lights = primary_rays(camera, pose, options.samples)
        hit = room.cast(o, d)
        points = o + hit['t_hit'][:, None] * d
        surface = room.surface(hit, points, d)
        start, to_light = points + 1e-4 * surface[0], LIGHTS[lights] - points
        dark, bright = shade(surface, d, to_light)
        lit = ~room.blocked(start, to_light, 1)
        seen = np.nonzero(may_meet(o, d, *bound))[0]
        shaded = np.nonzero(lit & may_meet(points, to_light, *bound))[0]
        cache.update(picture=np.where(lit[:, None], bright, dark), dark=dark[shaded], shaded=shaded, start=start[shaded],
                     to_light=to_light[shaded], seen=seen, o=o[seen], d=d[seen], lights=lights[seen], t=hit['t_hit'][seen],
                     all_t=hit['t_hit'])
    R, p = turn[:3, :3], turn[:3, 3]
    picture, label = cache['picture'].copy(), np.zeros(len(cache['picture']), np.uint8)
    fallen = table.blocked((cache['start'] - p) @ R, cache['to_light'] @ R, 1)
    picture[cache['shaded'][fallen]] = cache['dark'][fallen]
    o, d = (cache['o'] - p) @ R, cache['d'] @ R
    hit = table.cast(o, d)
    front = hit['t_hit'] < cache['t']
    hit, o, d = {k: v[front] for k, v in hit.items()}, o[front], d[front]
    points = o + hit['t_hit'][:, None] * d
    surface = table.surface(hit, points, d)
    start, to_light = points + 1e-4 * surface[0], (LIGHTS[cache['lights'][front]] - p) @ R - points
    lit = ~(table.blocked(start, to_light, 1) | room.blocked(start @ R.T + p, to_light @ R.T, 1))
    dark, bright = shade(surface, d, to_light)
    at = cache['seen'][front]
    picture[at], label[at] = np.where(lit[:, None], bright, dark), surface[4]
    distance = cache['all_t'].copy()
    distance[at] = hit['t_hit']
    return (picture.reshape(-1, height, width, 3)[:-1].mean(0), label.reshape(-1, height, width)[-1],
            distance.reshape(-1, height, width)[-1])


def develop(picture, exposure, rng, noise, grey_noise=0, sharpen=0):
    """Shot and read noise, tone curve, 8 bits. `exposure`: a factor, or one a channel; `grey_noise` comes after the tone
    curve [grey levels], and so does a mask of `sharpen` times what 1.2 pixels of blur take away."""
    picture = gaussian_filter(np.clip(picture * exposure, 0, 1), (0.45, 0.45, 0))
    picture = picture + rng.standard_normal(picture.shape) * noise * (0.3 + np.sqrt(picture))
    picture = np.clip(picture, 0, 1) ** (1 / 2.2) * 255
    if sharpen:
        picture = picture + sharpen * (picture - gaussian_filter(picture, (1.2, 1.2, 0)))
    if grey_noise:
        picture = picture + grey_noise * rng.standard_normal(picture.shape)
    return Image.fromarray(np.clip(picture + 0.5, 0, 255).astype(np.uint8))


# ---- what real captures have ----

def defocused(picture, distance, focus, at_infinity, layers=8):
    """A picture as an open lens takes it: what lies at `distance` is blurred by a Gaussian of at_infinity |1 - focus / distance|
    [pixels]. Layers from far to near, each blurred by itself and laid over those behind."""
    inverse = np.where(np.isfinite(distance), focus / np.maximum(distance, 1e-6), 0)
    knots = np.linspace(inverse.min(), inverse.max(), layers)
    at = (inverse - knots[0]) / max(knots[1] - knots[0], 1e-9)
    out, known = np.zeros_like(picture), np.zeros(distance.shape + (1,))
    for k, knot in enumerate(knots):
        share = np.clip(1 - np.abs(at - k), 0, 1)[..., None]
        sigma = max(at_infinity * abs(1 - knot), 1e-3)
        colour, share = gaussian_filter(picture * share, (sigma, sigma, 0)), gaussian_filter(share, (sigma, sigma, 0))
        out, known = out * (1 - share) + colour, known * (1 - share) + share
    return out / np.maximum(known, 1e-6)


def vignette(shape, loss):
    """Factors that fall by `loss` from the middle of a picture to its corners."""
    height, width = shape
    y, x = np.mgrid[0:height, 0:width] + 0.5
    return (1 - loss * ((x - width / 2) ** 2 + (y - height / 2) ** 2) / ((width ** 2 + height ** 2) / 4))[..., None]


def shaken(pose, pixels, focal, normals):
    """A pose turned about its own centre by angles of pixels / focal times three normals: about the picture's two axes and
    about the line of sight."""
    turn = np.asarray(normals) * pixels / focal
    angle = np.linalg.norm(turn) + 1e-12
    x, y, z = turn / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    out = pose.copy()
    out[:3] = rotation @ pose[:3]
    return out


def jumps(rng, count, factor):
    """Factors, one a photo, within `factor` of one another: each holds for a few photos, as automatic settings do."""
    values, level = np.ones(count), 0.0
    for k in range(count):
        if k == 0 or rng.random() < 0.25:
            level = rng.random() - 0.5
        values[k] = factor ** level
    return values


def wobbled(turn, degrees, angle, phases):
    """A pose of the table, tilted about the foot of its axis by up to so much: a plate that lies loose on its drive. The
    tilt goes round with the table once and twice a turn, and a fifth of it is of each photo alone."""
    a = np.radians(angle)
    smooth = 0.5 * np.cos(a + phases[:2]) + 0.3 * np.cos(2 * a + phases[2:4])
    tilt = np.radians(degrees) * (smooth + 0.2 * phases[4:6])
    c, s = np.cos(tilt), np.sin(tilt)
    about_x = np.array([[1, 0, 0], [0, c[0], -s[0]], [0, s[0], c[0]]])
    about_y = np.array([[c[1], 0, s[1]], [0, 1, 0], [-s[1], 0, c[1]]])
    pose = turn.copy()
    pose[:3, :3] = about_y @ about_x @ turn[:3, :3]
    pose[:3, 3] = AXIS - pose[:3, :3] @ AXIS
    return pose


def blob(rng, shape, points, radius, colour, volume):
    """A soft body along a line of picture points [shares of the width]: where it is, and its colours, which go with it."""
    height, width = shape
    y, x = np.mgrid[0:height, 0:width] / width
    distance = np.full(shape, np.inf)
    for (ax, ay), (bx, by) in zip(points[:-1], points[1:]):
        along = np.clip(((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2 + 1e-12), 0, 1)
        distance = np.minimum(distance, np.hypot(x - ax - along * (bx - ax), y - ay - along * (by - ay)))
    round_off = np.clip(1 - (distance / radius) ** 2, 0, 1)
    side = volume.shape[1]
    at = np.stack([np.full(shape, side * rng.random()), (y - points[0][1]) * side * 4, (x - points[0][0]) * side * 4])
    noise = map_coordinates(volume[0], at.reshape(3, -1), order=1, mode='grid-wrap').reshape(shape)
    shade = (0.35 + 0.65 * np.sqrt(round_off)) * np.clip(1 + 0.35 * noise, 0.2, 2)
    return np.clip(round_off * 12, 0, 1), np.asarray(colour)[None, None] * shade[..., None]


def add_hand(picture, label, rng, volume):
    """A forearm and a hand that come in from a side of the picture, in front of everything."""
    height, width = label.shape
    tip = np.array([0.3 + 0.4 * rng.random(), height / width * (0.45 + 0.25 * rng.random())])
    start = np.array([-0.05 if rng.random() < 0.5 else 1.05, height / width * (0.7 + 0.4 * rng.random())])
    knuckle = start + 0.8 * (tip - start)
    points = [tip, knuckle, start]
    share, colour = blob(rng, label.shape, points, 0.035 + 0.02 * rng.random(), [0.55, 0.33, 0.24], volume)
    label[share > 0.5] = 0
    return picture * (1 - share[..., None]) + colour * share[..., None]


def add_person(picture, behind, place, rng, volume):
    """Someone in the room, only where the picture shows what is far; `place` is where they stand [share of the width]."""
    height, width = behind.shape
    x = place + 0.03 * rng.standard_normal()
    top = height / width * (0.05 + 0.1 * rng.random())
    parts = [([(x, top + 0.22), (x + 0.03, height / width * 1.1)], 0.13, [0.12, 0.2, 0.4]), ([(x, top), (x, top + 0.06)], 0.06, [0.5, 0.32, 0.25])]
    for points, radius, colour in parts:
        share, colours = blob(np.random.default_rng(7), behind.shape, points, radius, colour, volume)
        share = (share * behind)[..., None]
        picture = picture * (1 - share) + colours * share
    return picture


def write_ply(path, meshes):
    v, f = [], []
    for mesh in meshes:
        f.append(mesh['f'].astype(np.int32) + sum(map(len, v)))
        v.append(mesh['v'])
    v, f = np.concatenate(v), np.concatenate(f)
    rows = np.empty(len(f), np.dtype([('n', 'u1'), ('i', '<i4', 3)]))
    rows['n'], rows['i'] = 3, f
    with open(path, 'wb') as out:
        out.write(f'ply\nformat binary_little_endian 1.0\nelement vertex {len(v)}\nproperty float x\nproperty float y\n'
                  f'property float z\nelement face {len(f)}\nproperty list uchar int vertex_indices\nend_header\n'.encode())
        out.write(v.astype('<f4').tobytes() + rows.tobytes())
    return [len(v), len(f)]


def parse_options():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument('folder')
    p.add_argument('--object', default='rock', choices=['vase', 'knot', 'rock', 'box', 'group'])
    p.add_argument('--size', type=float, default=0.16, help="the object's size [m]; the disc's diameter is 0.29")
    p.add_argument('--texture', type=float, default=0.35, help="contrast of the object's texture, 0 to 0.5")
    p.add_argument('--printed', action='store_true', help='the same picture on each side instead of a solid texture')
    p.add_argument('--gloss', type=float, default=0.0, help='highlights, 0 to 1')
    p.add_argument('--disc', default='speckled', choices=['speckled', 'plain'])
    p.add_argument('--background', default='cluttered', choices=['cluttered', 'bright', 'weak', 'plain'])
    p.add_argument('--things', type=int, default=30, help='things on the desk')
    p.add_argument('--stations', type=int, default=3)
    p.add_argument('--elevations', type=float, nargs=2, default=[12, 50], help='of the first and the last station [degrees]')
    p.add_argument('--around', type=float, default=0, help='arc over which the stations stand evenly [degrees]; 0: near one another')
    p.add_argument('--steps', type=int, nargs='+', default=[20], help='photos of each station; the last holds for all that follow')
    p.add_argument('--step', type=float, default=0, help='[degrees]; 0: a full turn')
    p.add_argument('--slow_start', type=int, default=0, help='first steps of each station that are of one degree')
    p.add_argument('--uneven', type=float, default=0, help='largest change of a step, as a share of it')
    p.add_argument('--hand_held', action='store_true', help='each photo from a place of its own near its station')
    p.add_argument('--width', type=int, default=640)
    p.add_argument('--height', type=int, default=480)
    p.add_argument('--focal', type=float, default=1.2, help='[image widths]')
    p.add_argument('--k1', type=float, default=0, help='radial distortion')
    p.add_argument('--fill', type=float, default=0.5, help="the disc's diameter as a share of the picture's width")
    p.add_argument('--samples', type=int, default=2, help='rays a pixel in each direction')
    p.add_argument('--noise', type=float, default=0.006)
    p.add_argument('--grey_noise', type=float, default=0, help='noise besides, after the tone curve [grey levels]')
    p.add_argument('--exposure_jumps', type=float, default=1, help='largest factor between the exposures of two photos')
    p.add_argument('--balance_jumps', type=float, default=1, help='the same of the red and the blue channel alone')
    p.add_argument('--wobble', type=float, default=0, help='largest tilt of the plate [degrees]')
    p.add_argument('--hands', type=int, default=0, help='photos with a hand in them')
    p.add_argument('--people', type=int, default=0, help='photos with a person in the background')
    p.add_argument('--defocus', type=float, default=0, help='blur of what is infinitely far, the object being sharp [pixels]')
    p.add_argument('--vignette', type=float, default=0, help='light lost in the corners, 0 to 1')
    p.add_argument('--sharpen', type=float, default=0, help="strength of the camera's own sharpening")
    p.add_argument('--shake', type=float, default=0, help='turns of the camera from photo to photo [pixels]')
    p.add_argument('--breathing', type=float, default=0, help='changes of the focal length from photo to photo [share]')
    p.add_argument('--quality', type=int, default=93, help='of JPEG')
    p.add_argument('--held_out', type=int, default=6, help='photos for images_test')
    p.add_argument('--seed', type=int, default=1)
    return p.parse_args()


def main():
    options = parse_options()
    rng = np.random.default_rng(options.seed)
    for folder in ('images', 'images_test', 'gt/masks'):
        os.makedirs(os.path.join(options.folder, folder), exist_ok=True)
    volume = noise_volume(rng)
    camera = (options.width, options.height, options.focal * options.width, options.k1)
    reach = options.focal * 2 * DISC_RADIUS / options.fill

    table = Bodies()
    base = 0.25 + 0.35 * rng.random(3)
    parts = make_object(options.object, options.size, rng, volume)
    shift = AXIS + [0.012, -0.008, 0.0]
    for v, f, smooth in parts:
        texture = noise_texture(volume, base, options.texture, 0.13)
        if options.printed:
            texture = picture_texture(draw_picture(np.random.default_rng(options.seed), 512, 260), (v.min(0) + v.max(0)) / 2 + shift, 0.1)
        table.add((v + shift, f, smooth), texture, options.gloss, 255)
    top = np.linspace(1e-4, DISC_RADIUS, 60)
    profile = [(r, DISC_BOTTOM) for r in top] + [(DISC_RADIUS, z) for z in (0.018, 0.023, 0.028)] + [(r, DISC_TOP) for r in top[::-1]]
    v, f, _ = lathe(profile)
    picture = speckles(rng, 1400, 1500 if options.disc == 'speckled' else 0, [0.4, 0.42, 0.4])
    table.add((v + AXIS * [1, 1, 0], f, False), picture_texture(picture, AXIS, 0.3), 0, 128)

    stations, shots = [], []
    counts = [options.steps[min(s, len(options.steps) - 1)] for s in range(options.stations)]
    steps = [options.step or 360 / count for count in counts]
    first_azimuth = rng.random() * 360
    for s in range(options.stations):
        share = s / max(1, options.stations - 1) if options.stations > 1 else 0.5
        elevation = options.elevations[0] + share * np.ptp(options.elevations)
        stations.append(dict(index=s, elevation_deg=elevation, azimuth_deg=first_azimuth + 55 * (rng.random() - 0.5) * (s > 0) + options.around * s / options.stations,
                             distance=reach * (0.95 + 0.15 * rng.random()), roll=0.06 * rng.standard_normal()))
        turned = steps[s] * (np.arange(counts[s]) + options.uneven * (2 * rng.random(counts[s]) - 1))
        turned = turned - turned[0] + (0 if s == 0 else steps[s] * rng.random())
        slow = np.minimum(np.arange(counts[s]), options.slow_start)
        turned = turned + slow - turned[slow] + turned[0]
        shots += [(s, angle, 'train') for angle in turned]
    for k in range(options.held_out):
        s = k % options.stations
        before = shots[sum(counts[:s]) + int(rng.integers(max(1, counts[s] - 1)))][1]
        shots.append((s, before + steps[s] * (0.3 + 0.4 * rng.random()), 'test'))

    height = np.concatenate([v for v, _, _ in parts])[:, 2].max()
    extent = np.concatenate([mesh['v'] for mesh in table.meshes])
    middle = AXIS + [0, 0, height / 2]
    bound = (middle, np.linalg.norm(extent - middle, axis=1).max() + 1e-3)
    target = AXIS + [0, 0, 0.35 * height]

    def place(station, spread):
        wobble = spread * rng.standard_normal(7)
        e, a = np.radians(station['elevation_deg'] + 2.5 * wobble[0]), np.radians(station['azimuth_deg'] + 4 * wobble[1])
        eye = target + station['distance'] * (1 + 0.04 * wobble[2]) * np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        return look_at(eye, target + 0.015 * wobble[3:6], station['roll'] + 0.03 * wobble[6])

    fixed = [place(s, 0) for s in stations]
    poses = [place(stations[s], 1) if options.hand_held else fixed[s] for s, _, _ in shots]
    lens = np.random.default_rng([options.seed, 2])
    if options.shake:
        poses = [shaken(pose, options.shake, camera[2], lens.standard_normal(3)) for pose in poses]
    focals = camera[2] * (1 + options.breathing * lens.standard_normal(len(shots)))
    eyes = [-p[:3, :3].T @ p[:3, 3] for p in (poses if options.hand_held else fixed)]
    room = build_room(options, rng, volume, eyes, reach)
    keep_occlusion(table, [room], rng)
    keep_occlusion(room, [table], rng)

    # Of their own, so that a scene without them stays as it was.
    real = np.random.default_rng([options.seed, 1])
    gains = np.stack([jumps(real, len(shots), options.balance_jumps), np.ones(len(shots)), jumps(real, len(shots), options.balance_jumps)], 1)
    gains *= jumps(real, len(shots), options.exposure_jumps)[:, None]
    phases = real.random((len(stations), 4)) * 2 * np.pi
    train = [k for k, (_, _, split) in enumerate(shots) if split == 'train']
    hands = set(real.permutation(train)[:options.hands].tolist())
    first = int(real.integers(max(1, len(train) - options.people + 1)))
    people = set(train[first:first + options.people])  # one after another, as someone who walks by

    images, cache, cached, exposure = [], {}, None, None
    for index, ((station, angle, split), pose) in sorted(enumerate(zip(shots, poses)), key=lambda i: (i[1][0][0], i[0])):
        key = index if options.hand_held or options.shake or options.breathing else station
        if key != cached:
            cache, cached = {}, key
        turn = turn_about_axis(angle)
        if options.wobble:
            turn = wobbled(turn, options.wobble, angle, np.concatenate([phases[station], 2 * real.random(2) - 1]))
        photo_camera = (*camera[:2], focals[index], camera[3])
        picture, label, distance = render(photo_camera, pose, turn, room, table, bound, cache, options)
        if options.defocus:
            picture = defocused(picture, distance, stations[station]['distance'], options.defocus)
        if options.vignette:
            picture = picture * vignette(label.shape, options.vignette)
        exposure = exposure or 0.5 / np.percentile(picture, 75)
        if index in people:
            o, d, _ = primary_rays(photo_camera, pose, 1)
            at = slice(-options.width * options.height, None)
            behind = (room.cast(o[at], d[at])['t_hit'] > stations[station]['distance'] + 0.2).reshape(label.shape) & (label == 0)
            picture = add_person(picture, behind, 0.1 + 0.8 * (index - train[first]) / max(1, options.people), real, volume)
        if index in hands:
            picture = add_hand(picture, label, real, volume)
        folder, name = 'images' if split == 'train' else 'images_test', f's{station}_{index:03d}'
        develop(picture, exposure * gains[index], rng, options.noise, options.grey_noise, options.sharpen).save(os.path.join(options.folder, folder, name + '.jpg'), quality=options.quality)
        Image.fromarray(label).save(os.path.join(options.folder, 'gt/masks', name + '.png'))
        images.append(dict(file=f'{folder}/{name}.jpg', mask=f'gt/masks/{name}.png', split=split,
                           station=index if options.hand_held else station, angle_deg=float(angle),
                           world_to_camera=pose.tolist(), object_to_world=turn.tolist()))
    images.sort(key=lambda i: (i['split'] == 'test', i['file']))
    object_counts = write_ply(os.path.join(options.folder, 'gt/object.ply'), [m for m in table.meshes if m['label'] == 255])
    disc_counts = write_ply(os.path.join(options.folder, 'gt/disc.ply'), [m for m in table.meshes if m['label'] == 128])
    camera_model = dict(camera_model='SIMPLE_RADIAL', k1=options.k1) if options.k1 else dict(camera_model='SIMPLE_PINHOLE')
    scene = dict(
        scene=os.path.basename(os.path.normpath(options.folder)), target_mesh=options.object,
        # Not where it lies, so that a scene rendered anew elsewhere has the same hash.
        options={name: value for name, value in vars(options).items() if name != 'folder'},
        width=options.width, height=options.height, **camera_model, fx=camera[2], fy=camera[2], cx=options.width / 2,
        cy=options.height / 2, units='metres', axis_point=AXIS.tolist(), axis_direction=[0, 0, 1], step_degrees=steps[0],
        pixel_convention='COLMAP: image origin at the top-left corner, centre of the first pixel at (0.5, 0.5)',
        rotation_sense='positive angle = right-handed about axis_direction (counter-clockwise seen from above)',
        mask_values=dict(object=255, disc=128, static=0),
        disc=dict(radius=DISC_RADIUS, z_bottom=DISC_BOTTOM, z_top=DISC_TOP), stations=stations, images=images,
        object_mesh_counts=object_counts, disc_mesh_counts=disc_counts)
    with open(os.path.join(options.folder, 'gt/scene.json'), 'w') as out:
        json.dump(scene, out, indent=1)


if __name__ == '__main__':
    main()
