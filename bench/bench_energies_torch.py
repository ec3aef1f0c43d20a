"""The same work in PyTorch: value and gradient of stretch + bend_twist + gravity + inertia, V = 25, f32, eager.

    python3 bench/bench_energies_torch.py build/bench/bench_energies [strands] [rounds]

Runs PyTorch and the bench program in turn, a few times, and prints the medians and their ratio. Everything that depends
on the rest groom alone is computed before the clock starts, as hairgrad does.
"""

import re
import statistics
import subprocess
import sys
import time

import torch

program = sys.argv[1] if len(sys.argv) > 1 else "build/bench/bench_energies"
strands = int(sys.argv[2]) if len(sys.argv) > 2 else 3000
rounds = int(sys.argv[3]) if len(sys.argv) > 3 else 5
torch.set_num_threads(2)
torch.manual_seed(1)
V, DT, STRETCH, BEND = 25, 1 / 30, 2.0, 1e-8


def dot(a, b):
    return (a * b).sum(-1)


def qmul(a, b):
    (aw, av), (bw, bv) = (a[..., :1], a[..., 1:]), (b[..., :1], b[..., 1:])
    w = aw * bw - (av * bv).sum(-1, keepdim=True)
    return torch.cat([w, aw * bv + bw * av + torch.linalg.cross(av, bv)], -1)


CONJ = torch.tensor([1.0, -1.0, -1.0, -1.0])


def rotate(q, v):
    t = 2 * torch.linalg.cross(q[..., 1:], v)
    return v + q[..., :1] * t + torch.linalg.cross(q[..., 1:], t)


def transport(a, b):
    h = a + b
    h = h / dot(h, h).clamp(min=1e-4).sqrt()[..., None]
    return torch.cat([dot(a, h)[..., None], torch.linalg.cross(*torch.broadcast_tensors(a, h))], -1)


def tangents(x, rest_length):
    edge = x[:, 1:] - x[:, :-1]
    return edge / torch.maximum(dot(edge, edge), (1e-3 * rest_length) ** 2).sqrt()[..., None]


def turns(t0, t):
    p = transport(t0[:, None], t)
    return qmul(p[:, :-1] * CONJ, p[:, 1:])


rest = torch.randn(strands, V, 3) * 1e-3
rest[..., 1] -= 4e-3 * torch.arange(V)
l0 = (rest[:, 1:] - rest[:, :-1]).norm(dim=-1).clamp(min=1e-6)
t_rest = tangents(rest, l0)
r0 = turns(t_rest[:, 0], t_rest)
mean = 0.5 * (l0[:, 1:] + l0[:, :-1])
mass = torch.ones(strands, V)
rotation = torch.tensor([1.0, 0, 0, 0]).expand(strands, 4)
x = (rest + 5e-4 * torch.randn_like(rest)).requires_grad_()
predicted = x.detach().clone()
g = torch.tensor([0, -9.81, 0])


def energy():
    edge = x[:, 1:] - x[:, :-1]
    stretch = 0.5 * STRETCH * ((edge.norm(dim=-1) - l0) ** 2).sum()
    t = tangents(x, l0)
    t0 = t[:, 0]
    frame = qmul(transport(rotate(rotation, t_rest[:, 0]), t0), rotation)[:, None]
    r = turns(t0, t)
    r = torch.cat([r[..., :1] * dot(frame, frame)[..., None], rotate(frame * CONJ, r[..., 1:])], -1)
    sign = torch.where(dot(r, r0) < 0, -1.0, 1.0)[..., None]
    omega = 2 / mean[..., None] * (sign * r[..., 1:] - r0[..., 1:])
    bend = 0.5 * BEND * (mean * dot(omega, omega)).sum()
    gravity = -(mass * (x @ g)).sum()
    inertia = (mass * ((x - predicted) ** 2).sum(-1)).sum() / (2 * DT * DT)
    return stretch + bend + gravity + inertia


def torch_ms(n):
    times = []
    for _ in range(n):
        start = time.perf_counter()
        x.grad = None
        energy().backward()
        times.append(1e3 * (time.perf_counter() - start))
    return times


def hairgrad_ms():
    found = {}
    text = subprocess.run([program, "2", "21"], capture_output=True, text=True, check=True).stdout
    for line in text.splitlines():
        row = re.match(r"f32\s+(\d+) strands\s+(\S.*?)\s+median\s+(\S+) ms", line)
        if row and int(row[1]) == strands:
            found[row[2]] = float(row[3])
    return found


torch_ms(3)
eager, ours = [], {}
for _ in range(rounds):
    eager += torch_ms(7)
    for name, ms in hairgrad_ms().items():
        ours.setdefault(name, []).append(ms)
base = statistics.median(eager)
print(f"{strands} strands, value and gradient, f32, 2 threads (PyTorch {torch.__version__}), medians:")
print(f"  PyTorch eager     {base:9.3f} ms   (best {min(eager):.3f})")
for name, ms in ours.items():
    print(f"  {name:16s}  {statistics.median(ms):9.3f} ms   {base / statistics.median(ms):6.1f} times faster   (best {min(ms):.3f}, {min(eager) / min(ms):.1f} times)")
