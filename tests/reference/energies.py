"""Reference values and gradients of every energy, written from the equations, with PyTorch's derivative in f64.

    python3 tests/reference/energies.py            writes tests/reference/energies.h5

tests/test_reference.c reads the file and compares. The script shares no code with the library: strands are plain loops
or whole-array formulas of the equations, neighbours and closest triangles are searched exhaustively, the gradient is
autograd's. Run again only when an equation changes; made with PyTorch 2.15 and h5py 3.16, any recent ones do.

Layout: /scene holds the inputs. One group per energy and choice of options, such as "bend_twist,strain=smooth,root=free"
(all options, in the order in which the energy declares them): value [], per_strand [B,S], gradient [B,S,V,3], and the
parameters that are not defaults as attributes. Under wrt/ is the gradient in everything else that the energy depends on,
by name: its parameters, "dt", "rest", "mass", attributes and arrays of the frame. "posed" there is what a frame brings;
the gradients in "rest", "root_rotation" and "root_position" are those of a posed groom made from them. A group with the
suffix "@degenerate" takes x from /scene/x_degenerate.
"""

import itertools
import os

import h5py
import numpy as np
import torch

torch.set_default_dtype(torch.float64)
random = np.random.default_rng(20250722)
G, B, S, V = 2, 2, 8, 9
GROOM = [1, 0]


# ---- quaternions (w, x, y, z), Hamilton ------------------------------------------------------------------------


def qmul(a, b):
    aw, ax, ay, az = a.unbind(-1)
    bw, bx, by, bz = b.unbind(-1)
    return torch.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        -1,
    )


def conj(q):
    return q * torch.tensor([1.0, -1.0, -1.0, -1.0])


def rotate(q, v):
    """q v conj(q)"""
    pure = torch.cat([torch.zeros_like(v[..., :1]), v], -1)
    return qmul(qmul(q, pure), conj(q))[..., 1:]


def dot(a, b):
    return (a * b).sum(-1)


def transport(a, b):
    h = a + b
    h = h / torch.sqrt(torch.clamp(dot(h, h), min=1e-4))[..., None]
    return torch.cat([dot(a, h)[..., None], torch.linalg.cross(a, h)], -1)


def tangent(edge, rest_length):
    floor = (1e-3 * rest_length) ** 2
    return edge / torch.sqrt(torch.maximum(dot(edge, edge), floor))[..., None]


def length(v):
    """Norm with gradient zero at zero."""
    square = dot(v, v)
    positive = square > 0
    return torch.where(positive, torch.sqrt(torch.where(positive, square, torch.ones_like(square))), 0.0)


# ---- the body: exhaustive closest triangle -----------------------------------------------------------------------


def closest_on_triangle(p, a, b, c):
    """Closest point and what it lies on: ("face",), ("edge", i, j) or ("vertex", i), by corner numbers."""
    best, where, nearest = np.inf, None, None
    corners = [a, b, c]
    normal = np.cross(b - a, c - a)
    if normal @ normal > 0:
        n = normal / np.linalg.norm(normal)
        q = p - (n @ (p - a)) * n
        if all(np.cross(corners[(k + 1) % 3] - corners[k], q - corners[k]) @ n > 0 for k in range(3)):
            best, where, nearest = np.linalg.norm(p - q), ("face",), q
    for k in range(3):
        u, w = corners[k], corners[(k + 1) % 3]
        t = np.clip((p - u) @ (w - u) / max((w - u) @ (w - u), 1e-300), 0.0, 1.0)
        q = u + t * (w - u)
        d = np.linalg.norm(p - q)
        if d < best:
            best, nearest = d, q
            where = ("vertex", k) if t == 0 else ("vertex", (k + 1) % 3) if t == 1 else ("edge", k, (k + 1) % 3)
    return best, where, nearest


def contact(p, vertices, faces, mode):
    """Plane (a, n) whose signed distance is n.(x - a)."""
    found = [closest_on_triangle(p, *vertices[face]) for face in faces]
    distances = np.array([f[0] for f in found])
    beyond = distances - distances.min()
    borderline = (beyond > 0.99e-6) & (beyond < 1.01e-6)
    assert mode == "exact" or not borderline.any(), "a triangle at the very limit of a tie: change the seed"
    normals = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    heights = np.abs(((p - vertices[faces[:, 0]]) * normals).sum(1))
    heights[beyond > 1e-6] = -1.0
    chosen = int(np.argmax(heights))
    _, where, nearest = found[chosen]
    if mode == "plane":
        return vertices[faces[chosen, 0]], normals[chosen]
    if where[0] == "face":
        pseudo = normals[chosen]
    elif where[0] == "edge":
        ends = {faces[chosen, where[1]], faces[chosen, where[2]]}
        pseudo = sum(normals[f] for f in range(len(faces)) if ends <= set(faces[f]))
    else:
        v = faces[chosen, where[1]]
        pseudo = np.zeros(3)
        for f in range(len(faces)):
            for k in range(3):
                if faces[f, k] == v:
                    e1, e2 = vertices[faces[f, (k + 1) % 3]] - vertices[v], vertices[faces[f, (k + 2) % 3]] - vertices[v]
                    angle = np.arccos(np.clip(e1 @ e2 / np.linalg.norm(e1) / np.linalg.norm(e2), -1.0, 1.0))
                    pseudo += angle * normals[f]
    direction = (p - nearest) / np.linalg.norm(p - nearest)
    return nearest, direction * (1.0 if direction @ pseudo >= 0 else -1.0)


# ---- the scene ---------------------------------------------------------------------------------------------------


def bumpy_sphere(rings=9, around=12):
    vertices, faces = [[0.0, 1.0, 0.0]], []
    for r in range(rings):
        theta = np.pi * (r + 1) / (rings + 1)
        for k in range(around):
            phi = 2 * np.pi * k / around
            vertices.append([np.sin(theta) * np.cos(phi), np.cos(theta), -np.sin(theta) * np.sin(phi)])
    vertices.append([0.0, -1.0, 0.0])
    last = len(vertices) - 1
    for k in range(around):
        n = (k + 1) % around
        faces.append([0, 1 + k, 1 + n])
        for r in range(rings - 1):
            a, b = 1 + r * around + k, 1 + r * around + n
            faces += [[a, a + around, b], [b, a + around, b + around]]
        faces.append([last, last - around + n, last - around + k])
    v = np.array(vertices)
    v *= 0.1 * (1 + 0.08 * np.sin(7 * v[:, :1]) * np.cos(5 * v[:, 2:]) + 0.03 * random.standard_normal((len(v), 1)))
    return v, np.array(faces, dtype=np.int32)


def random_rotation(spread):
    q = np.concatenate([[1.0], spread * random.standard_normal(3)])
    return q / np.linalg.norm(q)


def make_scene():
    body, faces = bumpy_sphere()
    rest = np.zeros((G, S, V, 3))
    for g in range(G):
        for s in range(S):
            theta, phi = 0.5 + 0.06 * (s % 3), 1.0 + 0.5 * g + 0.09 * (s // 3)
            out = np.array([np.sin(theta) * np.cos(phi), np.cos(theta), -np.sin(theta) * np.sin(phi)])
            side = np.cross(out, [0.3, 0.2, 1.0])
            side /= np.linalg.norm(side)
            third = np.cross(out, side)
            radius, turns = random.uniform(0.002, 0.004), random.uniform(0.8, 1.6)
            for v in range(V):
                t = v / (V - 1)
                curl = 2 * np.pi * turns * t
                rest[g, s, v] = out * (0.104 + 0.045 * np.sin(1.5 * t)) + np.array([0.0, -0.05 * t * t, 0.0])
                rest[g, s, v] += radius * ((np.cos(curl) - 1) * side + np.sin(curl) * third)
                rest[g, s, v] += 2e-4 * random.standard_normal(3)
    rotation = np.array([[random_rotation(0.4) for _ in range(S)] for _ in range(B)])
    position = np.stack([rest[GROOM[b], :, 0] + random.uniform(-0.01, 0.01, (S, 3)) for b in range(B)])
    q = torch.tensor(rotation)[:, :, None, :]
    arms = torch.tensor(np.stack([rest[GROOM[b]] - rest[GROOM[b], :, :1] for b in range(B)]))
    posed = rotate(q.expand(B, S, V, 4), arms).numpy() + position[:, :, None, :]
    x = posed + 0.0015 * random.standard_normal((B, S, V, 3))
    x[:, :, 3:] -= 0.012 * (x[:, :, 3:] - [0.0, 0.0, 0.0]) / 0.1  # some of it into the body
    # one edge of zero length, one kink of nearly 180 degrees (inside the guard), one strand against its rest direction
    degenerate = x.copy()
    degenerate[0, 1, 4] = degenerate[0, 1, 3]
    edge = degenerate[0, 2, 1] - degenerate[0, 2, 0]
    degenerate[0, 2, 5] = degenerate[0, 2, 4] - 1.1 * edge + 0.003 * np.linalg.norm(edge) * np.array([0.6, -0.8, 0.0])
    body_frames = np.stack(
        [body @ np.diag([1.0 + 0.05 * b, 1.0 - 0.04 * b, 1.02]) + 0.002 * random.standard_normal(body.shape) for b in range(B)]
    )
    distance = np.zeros((G, S, V))
    for g, s, v in itertools.product(range(G), range(S), range(V)):
        a, n = contact(rest[g, s, v], body, faces, "exact")
        distance[g, s, v] = n @ (rest[g, s, v] - a)
    return {
        "rest": rest,
        "mass": random.uniform(2e-8, 6e-8, (G, S, V)),
        "body_distance": distance,
        "scalp_distance": distance + random.uniform(0.0, 0.004, (G, S, V)),
        "root_rotation": rotation,
        "root_position": position,
        "x": x,
        "x_degenerate": degenerate,
        "predicted": x + 0.002 * random.standard_normal(x.shape),
        "previous": x + 0.002 * random.standard_normal(x.shape),
        "body_rest": body,
        "body_vertices": body_frames,
        "faces": faces,
        "groom": np.array(GROOM, dtype=np.int32),
    }


def more(scene):
    """Drawn after everything else, so that what is above stays what it is."""
    x = scene["x"]
    scene["ghost"] = x + 0.004 * random.standard_normal(x.shape)
    scene["ghost"][0, :3] += 0.05 * random.standard_normal((3, V, 3))  # some beyond half a strand, some beyond one
    scene["deformation"] = 0.01 * random.standard_normal(x.shape)
    e = torch.tensor(x[:, :, 1:] - x[:, :, :-1])
    t = e / torch.sqrt(dot(e, e))[..., None]
    e3 = torch.tensor([0.0, 0.0, 1.0]).expand_as(t)
    q = transport(e3, t).numpy() * (1 + 0.1 * random.standard_normal((B, S, V - 1, 1)))
    q += 0.15 * random.standard_normal(q.shape)
    q[:, :, 3] = -q[:, :, 3]  # the other sign is the same rotation
    scene["q"] = q
    return scene


scene = more(make_scene())
FLOATS = [name for name in scene if name not in ("faces", "groom", "x", "x_degenerate", "body_rest", "body_vertices")]
T, DT = {}, None


def fresh():
    """New leaves for everything that an energy may depend on; what follows from them is made anew."""
    global T, DT, rest, mass, R, posed
    T = {name: torch.tensor(scene[name]).requires_grad_(True) for name in FLOATS}
    DT = torch.tensor(1.0 / 30.0, requires_grad=True)
    rest = torch.stack([T["rest"][g] for g in GROOM])  # [B,S,V,3], as each frame uses it
    mass = torch.stack([T["mass"][g] for g in GROOM])
    R = T["root_rotation"]
    turned = rotate(R[:, :, None, :].expand(B, S, V, 4), rest - rest[:, :, :1])
    posed = turned + T["root_position"][:, :, None, :]


fresh()


# ---- the energies: each returns the sum over the sites of every strand, [B,S] --------------------------------------


def stretch(x, k):
    l0 = length(rest[:, :, 1:] - rest[:, :, :-1])
    l = length(x[:, :, 1:] - x[:, :, :-1])
    return (0.5 * k * (l - l0) ** 2).sum(-1)


def strain(r, r0, l, k, kind):
    alignment = dot(r, r0)
    if kind == "smooth":
        return 4 * k / l * (1 - torch.abs(alignment))
    sign = torch.where(alignment < 0, -1.0, 1.0)[..., None]
    omega = 2 / l[..., None] * (sign * r[..., 1:] - r0[..., 1:])
    return 0.5 * k * l * dot(omega, omega)


def chain(t):
    """Parallel transport from edge to edge, the identity at the root: p_{i+1} = transport(t_i -> t_{i+1}) p_i"""
    p = [torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(B, S, 4)]
    for i in range(V - 2):
        p.append(qmul(transport(t[:, :, i], t[:, :, i + 1]), p[-1]))
    return torch.stack(p, 2)


def bend_twist(x, k, kind, root, carried=False):
    e0, e = rest[:, :, 1:] - rest[:, :, :-1], x[:, :, 1:] - x[:, :, :-1]
    l0 = torch.clamp(length(e0), min=1e-6)
    t_rest, t = tangent(e0, l0), tangent(e, l0)
    F = qmul(transport(rotate(R, t_rest[:, :, 0]), t[:, :, 0]), R)  # [B,S,4]
    if carried:
        p, p_rest = chain(t), chain(t_rest)
    else:
        p = transport(t[:, :, :1].expand_as(t), t)
        p_rest = transport(t_rest[:, :, :1].expand_as(t_rest), t_rest)
    r0 = qmul(conj(p_rest[:, :, :-1]), p_rest[:, :, 1:])
    along = F[:, :, None, :].expand_as(r0)
    r = qmul(qmul(conj(along), qmul(conj(p[:, :, :-1]), p[:, :, 1:])), along)
    energy = strain(r, r0, 0.5 * (l0[:, :, :-1] + l0[:, :, 1:]), k, kind).sum(-1)
    if root == "clamped":
        one = torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(B, S, 4)
        energy = energy + strain(qmul(conj(R), F), one, l0[:, :, 0], k, kind)
    return energy


def gravity(x, g):
    return -(mass * (x @ g)).sum(-1)


def inertia(x):
    d = x - T["predicted"]
    return (mass / (2 * DT**2) * dot(d, d)).sum(-1)


def drag(x, c):
    d = x - T["previous"]
    return (mass * c / (2 * DT) * dot(d, d)).sum(-1)


def body_collision(x, k, D, mode, rest_clearance):
    a, n = np.zeros((B, S, V, 3)), np.zeros((B, S, V, 3))
    points = x.detach().numpy()
    for b, s, v in itertools.product(range(B), range(S), range(V)):
        a[b, s, v], n[b, s, v] = contact(points[b, s, v], scene["body_vertices"][b], scene["faces"], mode)
    d = dot(torch.tensor(n), x - torch.tensor(a))
    clearance = D.expand(B, S, V)
    if rest_clearance == "true":
        at_rest = torch.stack([T["body_distance"][g] for g in GROOM])
        clearance = torch.minimum(clearance, torch.clamp(at_rest, min=0.0005))
    return (k * torch.clamp(clearance - d, min=0.0) ** 3).sum(-1)


def kernel(r, h):
    s = r / h
    inner, outer = 4 - 6 * s**2 + 3 * s**3, (2 - s) ** 3
    return torch.where(s <= 1, inner, torch.where(s <= 2, outer, torch.zeros_like(s)))


def density(points, weights, h):
    """points [n,3]; self included"""
    r = length(points[:, None, :] - points[None, :, :])
    return (weights[None, :] * kernel(r, h)).sum(1)


def self_collision(x, k, h, kernel_mass):
    energy = []
    for b in range(B):
        weights = mass[b].reshape(-1) if kernel_mass == "kg" else torch.ones(S * V)
        excess = density(x[b].reshape(-1, 3), weights, h) - density(rest[b].reshape(-1, 3), weights, h)
        energy.append((k * torch.clamp(excess, min=0.0) ** 3).reshape(S, V).sum(-1))
    return torch.stack(energy)


def hair_style(x, k, s_max, surface):
    s = torch.stack([T["body_distance" if surface == "body" else "scalp_distance"][g] for g in GROOM]).clamp(min=0.0)
    d = x - posed
    return (k * (1 - torch.clamp(s / s_max, max=1.0)) * dot(d, d)).sum(-1)


def adhesion(x, k, radius, count, rest_length):
    energy = []
    for b in range(B):
        at_rest, now = rest[b].reshape(-1, 3), x[b].reshape(-1, 3)
        of_strand = [torch.zeros(()) for _ in range(S)]
        for i in range(S * V):
            d0 = torch.sqrt(((at_rest - at_rest[i]) ** 2).sum(-1)).detach().numpy()
            near = [j for j in np.argsort(d0, kind="stable") if j // V != i // V and d0[j] <= radius][: int(count)]
            for j in near:
                d = length(now[i] - now[j])
                then = length(at_rest[i] - at_rest[j]) if rest_length == "true" else 0.0
                of_strand[i // V] = of_strand[i // V] + k * (d - then) ** 2
        energy.append(torch.stack(of_strand))
    return torch.stack(energy)


def spring(x, k, n):
    d0, d = rest[:, :, n:] - rest[:, :, :-n], x[:, :, n:] - x[:, :, :-n]
    return (0.5 * k * (length(d) - length(d0)) ** 2).sum(-1)


def shear(x, k):
    e, e_posed = x[:, :, 1:] - x[:, :, :-1], posed[:, :, 1:] - posed[:, :, :-1]
    l0 = length(rest[:, :, 1:] - rest[:, :, :-1])
    d = e / l0[..., None] - e_posed / length(e_posed)[..., None]
    return (0.5 * k * dot(d, d)).sum(-1)


def cosserat_stretch_shear(x, k):
    l0 = length(rest[:, :, 1:] - rest[:, :, :-1])
    e3 = torch.tensor([0.0, 0.0, 1.0]).expand(B, S, V - 1, 3)
    d = (x[:, :, 1:] - x[:, :, :-1]) / l0[..., None] - rotate(T["q"], e3)
    return (0.5 * k * dot(d, d)).sum(-1)


def cosserat_bend_twist(x, k):
    l0 = length(rest[:, :, 1:] - rest[:, :, :-1])
    t = (rest[:, :, 1:] - rest[:, :, :-1]) / l0[..., None]
    e3 = torch.tensor([0.0, 0.0, 1.0]).expand(B, S, 3)
    q0 = qmul(chain(t), transport(e3, t[:, :, 0])[:, :, None, :].expand(B, S, V - 1, 4))
    q = T["q"]
    r, r0 = qmul(conj(q[:, :, :-1]), q[:, :, 1:]), qmul(conj(q0[:, :, :-1]), q0[:, :, 1:])
    sign = torch.where(dot(r, r0) < 0, -1.0, 1.0)[..., None]
    omega = 4 / (l0[:, :, :-1] + l0[:, :, 1:])[..., None] * (sign * r[..., 1:] - r0[..., 1:])
    return (0.5 * k * dot(omega, omega)).sum(-1)


def unit_quaternion(x, k):
    return (0.5 * k * (length(T["q"]) - 1) ** 2).sum(-1)


def integrity(x, k, curve):
    """The tension is integrated by Gauss's rule on each piece: not the polynomial that the library writes."""
    d = length(x - T["ghost"])
    if curve == "hookean":
        return (0.5 * k * d**2).sum(-1)
    strand = length(rest[:, :, 1:] - rest[:, :, :-1]).sum(-1).detach()[..., None]  # [B,S,1]; no derivative
    nodes, weights = np.polynomial.legendre.leggauss(6)
    energy = 0.5 * k * torch.minimum(d, 0.5 * strand) ** 2
    end = torch.minimum(torch.maximum(d, 0.5 * strand), strand)
    for node, weight in zip(nodes, weights):
        at = 0.5 * strand + (end - 0.5 * strand) * 0.5 * (1 + node)
        u = 2 * at / strand - 1
        hermite_value, hermite_slope = (1 + 2 * u) * (1 - u) ** 2, u * (1 - u) ** 2
        tension = k * 0.5 * strand * (hermite_value + hermite_slope)  # T(L/2) = k L/2, dT/du = k L/2 there, 0 at L
        energy = energy + 0.5 * weight * (end - 0.5 * strand) * tension
    return energy.sum(-1)


def angular(x, k):
    a, b = T["ghost"][:, :, 1:] - x[:, :, :-1], x[:, :, 1:] - x[:, :, :-1]
    theta = torch.arccos(dot(a, b) / torch.sqrt(dot(a, a) * dot(b, b)))
    return (0.5 * k * theta**2).sum(-1)


def pose_reg(x, k):
    d = T["deformation"]
    difference = d.mean(0, keepdim=True) - d
    return (k * dot(difference, difference)).sum(-1)


# name, options with their choices, parameters that differ from the defaults (by their names), function of both
CASES = [
    ("stretch", {}, {"stiffness": 1.7}, lambda x, o, p: stretch(x, p["stiffness"])),
    (
        "bend_twist",
        {"strain": ["published", "smooth"], "root": ["free", "clamped"]},
        {"stiffness": 2.3e-8},
        lambda x, o, p: bend_twist(x, p["stiffness"], o["strain"], o["root"]),
    ),
    (
        "gravity",
        {},
        {"g.x": 0.7, "g.y": -9.6, "g.z": 1.1},
        lambda x, o, p: gravity(x, torch.stack([p["g.x"], p["g.y"], p["g.z"]])),
    ),
    ("inertia", {}, {}, lambda x, o, p: inertia(x)),
    ("drag", {}, {"c": 2.5}, lambda x, o, p: drag(x, p["c"])),
    (
        "body_collision",
        {"mode": ["plane", "exact"], "rest_clearance": ["true", "false"]},
        {"stiffness": 25.0, "distance": 0.006},
        lambda x, o, p: body_collision(x, p["stiffness"], p["distance"], o["mode"], o["rest_clearance"]),
    ),
    (
        "self_collision",
        {"kernel_mass": ["unit"]},
        {"stiffness": 3e-10, "h": 0.004},
        lambda x, o, p: self_collision(x, p["stiffness"], p["h"], o["kernel_mass"]),
    ),
    (
        "self_collision",
        {"kernel_mass": ["kg"]},
        {"stiffness": 3e12, "h": 0.004},
        lambda x, o, p: self_collision(x, p["stiffness"], p["h"], o["kernel_mass"]),
    ),
    (
        "hair_style",
        {"surface": ["body", "scalp"]},
        {"stiffness": 0.004, "s_max": 0.02},
        lambda x, o, p: hair_style(x, p["stiffness"], p["s_max"], o["surface"]),
    ),
    (
        "adhesion",
        {"rest_length": ["false", "true"]},
        {"stiffness": 2e-6, "radius": 0.007, "count": 4},
        lambda x, o, p: adhesion(x, p["stiffness"], p["radius"].item(), int(p["count"].item()), o["rest_length"]),
    ),
    (
        "bend_twist_chain",
        {"strain": ["published", "smooth"], "root": ["free", "clamped"]},
        {"stiffness": 2.3e-8},
        lambda x, o, p: bend_twist(x, p["stiffness"], o["strain"], o["root"], carried=True),
    ),
    ("shear", {}, {"stiffness": 3e-6}, lambda x, o, p: shear(x, p["stiffness"])),
    ("cosserat_stretch_shear", {}, {"stiffness": 3e-6}, lambda x, o, p: cosserat_stretch_shear(x, p["stiffness"])),
    ("cosserat_bend_twist", {}, {"stiffness": 3e-11}, lambda x, o, p: cosserat_bend_twist(x, p["stiffness"])),
    ("unit_quaternion", {}, {"stiffness": 4e-6}, lambda x, o, p: unit_quaternion(x, p["stiffness"])),
    ("spring_edge", {}, {"stiffness": 1.7}, lambda x, o, p: spring(x, p["stiffness"], 1)),
    ("spring_bend", {}, {"stiffness": 0.7}, lambda x, o, p: spring(x, p["stiffness"], 2)),
    ("spring_torsion", {}, {"stiffness": 0.3}, lambda x, o, p: spring(x, p["stiffness"], 3)),
    (
        "integrity",
        {"curve": ["hookean", "softening"]},
        {"stiffness": 0.002},
        lambda x, o, p: integrity(x, p["stiffness"], o["curve"]),
    ),
    ("angular", {}, {"stiffness": 2e-7}, lambda x, o, p: angular(x, p["stiffness"])),
    ("pose_reg", {}, {"stiffness": 0.003}, lambda x, o, p: pose_reg(x, p["stiffness"])),
]
DEGENERATE = {
    "stretch", "bend_twist", "bend_twist_chain", "self_collision", "adhesion", "shear", "spring_edge", "spring_bend",
    "spring_torsion", "cosserat_stretch_shear",
}
NO_POSITIONS = {"cosserat_bend_twist", "unit_quaternion", "pose_reg"}


def derivatives(value, x, params):
    """Gradient in x, and in everything else that value depends on."""
    leaves = dict(T, dt=DT, posed=posed, **params)
    found = torch.autograd.grad(value, [x] + list(leaves.values()), allow_unused=True)
    gradient = torch.zeros_like(x) if found[0] is None else found[0]
    others = {name: g for name, g in zip(leaves, found[1:]) if g is not None and g.abs().max() > 1e-13 * abs(value)}
    return gradient, others


def write(path):
    with h5py.File(path, "w") as file:
        for name, value in scene.items():
            file["scene/" + name] = value
        for name, options, numbers, energy in CASES:
            for choices in itertools.product(*options.values()):
                chosen = dict(zip(options, choices))
                label = ",".join([name] + [f"{o}={c}" for o, c in chosen.items()])
                for suffix in ["", "@degenerate"] if name in DEGENERATE else [""]:
                    fresh()
                    x = torch.tensor(scene["x_degenerate" if suffix else "x"]).requires_grad_(True)
                    params = {p: torch.tensor(float(number), requires_grad=True) for p, number in numbers.items()}
                    per_strand = energy(x, chosen, params)
                    value = per_strand.sum()
                    gradient, others = derivatives(value, x, params)
                    assert torch.isfinite(value) and torch.isfinite(gradient).all(), label
                    moved = gradient if name not in NO_POSITIONS else others.get("q", others.get("deformation"))
                    assert moved.abs().max() > 0, label + " has no gradient: nothing is tested"
                    group = file.create_group(label + suffix)
                    group["value"] = value.item()
                    group["per_strand"] = per_strand.detach().numpy()
                    group["gradient"] = gradient.numpy()
                    for other, found in others.items() if not suffix else []:
                        assert torch.isfinite(found).all(), label + " " + other
                        group["wrt/" + other] = found.numpy()
                    for param, number in numbers.items():
                        group.attrs[param] = float(number)
                    active = (moved.abs().amax(-1) > 0).double().mean().item()
                    print(f"{label + suffix:56s} {value.item():14.6e}  {100 * active:5.1f} %  {' '.join(others)}")


if __name__ == "__main__":
    write(os.path.join(os.path.dirname(os.path.abspath(__file__)), "energies.h5"))
