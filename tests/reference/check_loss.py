"""`hairgrad loss` as somebody with NumPy uses it: arrays in, value and gradients out, held against formulas written here.

    python3 tests/reference/check_loss.py HAIRGRAD FOLDER

Values and gradients are the equations' and their derivatives by hand, in f64; no file and no code is shared with the
library. Every case also runs in f32. Says "ok NAME" or "not ok NAME: why"; exits 1 when one was wrong.
"""

import os
import subprocess
import sys

import h5py
import numpy as np

random = np.random.default_rng(7)
program, folder = sys.argv[1], sys.argv[2]
B, S, V = 2, 5, 7
wrong = 0


def loss(name, arrays, dtype="f64", settings=(), wrt=None):
    """The datasets that `hairgrad loss` writes, as a dictionary."""
    given, made = os.path.join(folder, "in.h5"), os.path.join(folder, "out.h5")
    with h5py.File(given, "w") as file:
        for key, value in arrays.items():
            file[key] = value
    command = [program, "loss", name, given, "-o", made, "--dtype", dtype]
    for setting in settings:
        command += ["--set", setting]
    if wrt:
        command += ["--wrt", ",".join(wrt)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr.strip())
    with h5py.File(made) as file:
        return {key: file[key][()] for key in file}


def check(name, arrays, energy, gradients, settings=(), label=None):
    """energy: number; gradients: by name. In f64 to 1e-10, in f32 to what f32 gives."""
    global wrong
    problems = []
    for dtype, tolerance in (("f64", 1e-10), ("f32", 2e-4)):
        try:
            out = loss(name, arrays, dtype, settings, list(gradients))
        except RuntimeError as error:
            problems.append(str(error))
            break
        if out["energy"].dtype != np.float64 or out["energy"].shape != ():
            problems.append("energy is not an f64 scalar")
        if abs(out["energy"] - energy) > tolerance * abs(energy):
            problems.append(f"{dtype} energy {out['energy']}, expected {energy}")
        for key, want in gradients.items():
            got = out["grad_" + key]
            if got.shape != np.shape(want) or got.dtype != (np.float64 if dtype == "f64" else np.float32):
                problems.append(f"grad_{key} is {got.dtype} {got.shape}, expected {dtype} {np.shape(want)}")
            elif np.abs(got - want).max() > tolerance * np.abs(want).max():
                problems.append(f"{dtype} grad_{key} off by {np.abs(got - want).max() / np.abs(want).max():.2e}")
    wrong += bool(problems)
    print(("not ok " if problems else "ok ") + (label or name) + (": " + "; ".join(problems) if problems else ""))


def scatter(edge, step, n=V):
    """dE/d(edge i) -> dE/dx of vertices i and i + step."""
    out = np.zeros(edge.shape[:-2] + (n, 3))
    out[..., step:, :] += edge
    out[..., :-step, :] -= edge
    return out


def length(v):
    return np.linalg.norm(v, axis=-1)


rest = np.cumsum(np.concatenate([np.zeros((S, 1, 3)), [0.001, -0.004, 0.0005] + 0.001 * random.standard_normal((S, V - 1, 3))], 1), 1)
rest += 0.01 * random.standard_normal((S, 1, 3))
x = rest + 0.001 * random.standard_normal((B, S, V, 3))
mass = random.uniform(2e-8, 6e-8, (S, V))
other = x + 0.002 * random.standard_normal(x.shape)
k = 1.7


def spring(step):
    d, d0 = x[..., step:, :] - x[..., :-step, :], rest[..., step:, :] - rest[..., :-step, :]
    l, l0 = length(d), length(d0)
    along = (k * (l - l0) / l)[..., None] * d
    along0 = (k * (l0 - l) / l0)[..., None] * d0
    value = 0.5 * k * ((l - l0) ** 2).sum()
    return value, {"x": scatter(along, step), "stiffness": value / k, "rest": scatter(along0, step).sum(0)}


for name, step in (("stretch", 1), ("spring_edge", 1), ("spring_bend", 2), ("spring_torsion", 3)):
    value, gradients = spring(step)
    check(name, {"x": x, "rest": rest}, value, gradients, [f"stiffness={k}"])

# A stiffness per strand, and one per strand and frame; f32 files; one frame without its axis.
per_strand = random.uniform(1.0, 3.0, S)
edges, edges0 = np.diff(x, axis=2), np.diff(rest, axis=1)
strain = 0.5 * (length(edges) - length(edges0)) ** 2
check("stretch", {"x": x, "rest": rest, "stiffness": per_strand}, (per_strand[None, :, None] * strain).sum(),
      {"stiffness": strain.sum((0, 2))}, label="stretch, stiffness [S]")
per_frame = random.uniform(1.0, 3.0, (B, S))
check("stretch", {"x": x, "rest": rest, "stiffness": per_frame}, (per_frame[:, :, None] * strain).sum(),
      {"stiffness": strain.sum(2)}, label="stretch, stiffness [B,S]")
narrow, narrow0 = x[0].astype("f4"), rest.astype("f4")
d = np.diff(narrow.astype("f8"), axis=1)
l, l0 = length(d), length(np.diff(narrow0.astype("f8"), axis=1))
check("stretch", {"x": narrow, "rest": narrow0}, (l - l0).__pow__(2).sum(), {"x": scatter((2 * (l - l0) / l)[..., None] * d, 1)},
      ["stiffness=2000 mN/m"], label="stretch, one frame, f32 file")

g = np.array([0.5, -9.0, 1.0])
check("gravity", {"x": x, "mass": mass}, -(mass * (x @ g)).sum(),
      {"x": np.broadcast_to(-mass[..., None] * g, x.shape), "g": -(mass[..., None] * x).sum((0, 1, 2)), "mass": -(x @ g).sum(0)},
      ["g=0.5,-9,1"])
check("gravity", {"x": x, "mass": 3e-8}, 3e-8 * 9.81 * x[..., 1].sum(), {"mass": 9.81 * x[..., 1].sum()}, label="gravity, one mass")

dt = 0.02
square = ((x - other) ** 2).sum(-1)
value = (mass / (2 * dt**2) * square).sum()
towards = (mass / dt**2)[..., None] * (x - other)
check("inertia", {"x": x, "predicted": other, "mass": mass, "dt": dt}, value,
      {"x": towards, "predicted": -towards, "mass": square.sum(0) / (2 * dt**2), "dt": -2 * value / dt})
c = 2.5
value = (mass * c / (2 * dt) * square).sum()
check("drag", {"x": x, "previous": other, "mass": mass}, value,
      {"x": (mass * c / dt)[..., None] * (x - other), "c": value / c, "dt": -value / dt}, [f"c={c}", f"dt={dt}"])

posed = rest + 0.002 * random.standard_normal(x.shape)
e, p = np.diff(x, axis=2), np.diff(posed, axis=2)
l0 = length(np.diff(rest, axis=1))
d = e / l0[..., None] - p / length(p)[..., None]
check("shear", {"x": x, "rest": rest, "posed": posed}, 0.5 * 3e-6 * (d**2).sum(),
      {"x": scatter(3e-6 * d / l0[..., None], 1), "stiffness": 0.5 * (d**2).sum()}, ["stiffness=3e-6"])

near = random.uniform(-0.002, 0.02, (S, V))
weight = 1 - np.minimum(1, np.maximum(near, 0) / 0.01)
check("hair_style", {"x": x, "posed": posed, "body_distance": near}, 0.004 * (weight * ((x - posed) ** 2).sum(-1)).sum(),
      {"x": 2 * 0.004 * weight[..., None] * (x - posed), "posed": -2 * 0.004 * weight[..., None] * (x - posed),
       "stiffness": (weight * ((x - posed) ** 2).sum(-1)).sum()}, ["stiffness=0.004", "s_max=1 cm"])

pairs = np.array([(i, j) for i in range(0, S * V, 3) for j in range(1, S * V, 4) if i // V != j // V])
flat = x.reshape(B, S * V, 3)
d = flat[:, pairs[:, 0]] - flat[:, pairs[:, 1]]
force = np.zeros_like(flat)
for b in range(B):
    np.add.at(force[b], pairs[:, 0], 2 * 2e-6 * d[b])
    np.add.at(force[b], pairs[:, 1], -2 * 2e-6 * d[b])
check("adhesion", {"x": x, "neighbours": pairs}, 2e-6 * (d**2).sum(), {"x": force.reshape(x.shape), "stiffness": (d**2).sum()},
      ["stiffness=2e-6"])


def kernel(s):
    return np.where(s <= 1, 4 - 6 * s**2 + 3 * s**3, np.where(s <= 2, (2 - s) ** 3, 0.0))


def slope(s):
    return np.where(s <= 1, -12 * s + 9 * s**2, np.where(s <= 2, -3 * (2 - s) ** 2, 0.0))


h, stiffness, m = 0.004, 3e12, mass.reshape(-1)
value, force = 0.0, np.zeros_like(flat)
for b in range(B):
    arm = flat[b][:, None] - flat[b][None]
    r, r0 = length(arm), length(rest.reshape(-1, 3)[:, None] - rest.reshape(-1, 3)[None])
    excess = np.maximum((kernel(r / h) - kernel(r0 / h)) @ m, 0)
    value += stiffness * (excess**3).sum()
    push = 3 * stiffness * excess**2
    pull = (push[:, None] * m[None] + push[None] * m[:, None]) * slope(r / h) / h / np.where(r > 0, r, 1)
    force[b] = (pull[..., None] * arm).sum(1)
check("self_collision", {"x": x, "rest": rest, "mass": mass}, value, {"x": force.reshape(x.shape), "stiffness": value / stiffness},
      [f"stiffness={stiffness}", f"h={h}"])

# A floor of two triangles, turned to +Y: the distance to it is y.
floor = np.array([[-1.0, -0.03, -1.0], [-1.0, -0.03, 1.0], [1.0, -0.03, 1.0], [1.0, -0.03, -1.0]])
low = x - [0, 0.01, 0]
depth = np.maximum(0.02 - (low[..., 1] + 0.03), 0)
force = np.zeros_like(x)
force[..., 1] = -3 * 25 * depth**2
for mode in ("plane", "exact"):
    check("body_collision", {"x": low, "body_vertices": np.broadcast_to(floor, (B, 4, 3)), "body_faces": np.array([[0, 1, 2], [0, 2, 3]])},
          25 * (depth**3).sum(), {"x": force, "stiffness": (depth**3).sum(), "distance": 3 * 25 * (depth**2).sum()},
          ["stiffness=25", "distance=2 cm", f"mode={mode}"], label=f"body_collision, {mode}")

d = x - other
check("integrity", {"x": x, "rest": rest, "ghost": other}, 0.5 * 0.002 * (d**2).sum(),
      {"x": 0.002 * d, "ghost": -0.002 * d, "stiffness": 0.5 * (d**2).sum()}, ["stiffness=0.002"])

q = random.standard_normal((B, S, V - 1, 4))
n = np.linalg.norm(q, axis=-1)
check("unit_quaternion", {"q": q}, 0.5 * 3e-6 * ((n - 1) ** 2).sum(),
      {"q": (3e-6 * (n - 1) / n)[..., None] * q, "stiffness": 0.5 * ((n - 1) ** 2).sum()}, ["stiffness=3e-6"])

moved = 0.002 * random.standard_normal((4, S, V, 3))
d = moved - moved.mean(0)
check("pose_reg", {"deformation": moved}, 0.003 * (d**2).sum(), {"deformation": 2 * 0.003 * d, "stiffness": (d**2).sum()}, ["stiffness=0.003"])

# Without --wrt: x, and where there is none what stands in its place.
names = set(loss("pose_reg", {"deformation": moved})) | set(loss("unit_quaternion", {"q": q})) | set(loss("stretch", {"x": x, "rest": rest}))
if names != {"energy", "grad_deformation", "grad_q", "grad_x"}:
    wrong += 1
    print("not ok what is written without --wrt:", sorted(names))

sys.exit(wrong > 0)
