"""The other side of ./run bench: PyTorch and ONNX Runtime on the arrays that bench wrote, two threads, or on a GPU.

    peer.py ROW FOLDER [cuda]

Says "ready VARIANT ... | what it is" or "none reason", then answers "run VARIANT N" with N times in ms and "memory
VARIANT" with bytes. Every function is written as one would write it in PyTorch: tensor operations over whole batches,
what depends on the rest groom alone computed before the clock starts.
"""

import os
import resource
import signal
import sys
import time

answers = os.fdopen(os.dup(1), "w", buffering=1)
os.dup2(2, 1)  # what libraries print goes elsewhere


def too_long(*_):
    raise TimeoutError("not ready in time")


signal.signal(signal.SIGALRM, too_long)


def say(text):
    answers.write(text + "\n")
    answers.flush()


row, folder = sys.argv[1], sys.argv[2]
DEVICE = "cuda" if sys.argv[3:4] and sys.argv[3].startswith("cuda") else "cpu"
try:
    import numpy as np
except ImportError:
    say("none NumPy is not installed")
    sys.exit()


def array(name):
    return np.load(f"{folder}/{name}.npy")


# ---- ONNX Runtime -----------------------------------------------------------------------------------------------


def inference():
    try:
        import onnxruntime
    except ImportError:
        return "ONNX Runtime is not installed", {}
    if DEVICE == "cuda" and "CUDAExecutionProvider" not in onnxruntime.get_available_providers():
        return "this ONNX Runtime has no CUDA provider", {}
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 2
    session = onnxruntime.InferenceSession(f"{folder}/model.onnx", options, providers=["CUDAExecutionProvider" if DEVICE == "cuda" else "CPUExecutionProvider"])
    strands, columns = array("count")
    given = session.get_inputs()[0]
    features = np.random.default_rng(1).standard_normal((strands, columns), dtype=np.float32)
    return f"ONNX Runtime {onnxruntime.__version__}, features concatenated before the clock starts", {
        "onnx": lambda: session.run(None, {given.name: features})
    }


# ---- PyTorch ----------------------------------------------------------------------------------------------------

try:
    if row != "inference":
        import torch

        torch.set_num_threads(2)
        torch.manual_seed(1)
        if DEVICE == "cuda" and not torch.cuda.is_available():
            say("none this PyTorch finds no GPU")
            sys.exit()
        torch.set_default_device(DEVICE)
except ImportError:
    say("none PyTorch is not installed")
    sys.exit()

DT, STRETCH, BEND = 1 / 30, 2.0, 1e-8


def tensor(name):
    return torch.from_numpy(array(name)).to(DEVICE)


def dot(a, b):
    return (a * b).sum(-1)


def cross(a, b):
    return torch.linalg.cross(*torch.broadcast_tensors(a, b))


def qmul(a, b):
    (aw, av), (bw, bv) = (a[..., :1], a[..., 1:]), (b[..., :1], b[..., 1:])
    w = aw * bw - (av * bv).sum(-1, keepdim=True)
    return torch.cat([w, aw * bv + bw * av + cross(av, bv)], -1)


def conjugate(q):
    return torch.cat([q[..., :1], -q[..., 1:]], -1)


def rotate(q, v):
    t = 2 * cross(q[..., 1:], v)
    return v + q[..., :1] * t + cross(q[..., 1:], t)


def transport(a, b):
    h = a + b
    h = h / dot(h, h).clamp(min=1e-4).sqrt()[..., None]
    return torch.cat([dot(a, h)[..., None], cross(a, h)], -1)


def tangents(x, rest_length):
    edge = x[..., 1:, :] - x[..., :-1, :]
    return edge / torch.maximum(dot(edge, edge), (1e-3 * rest_length) ** 2).sqrt()[..., None]


def turns(t):
    p = transport(t[..., :1, :], t)
    return qmul(conjugate(p[..., :-1, :]), p[..., 1:, :])


class Rest:
    def __init__(self, rest):
        self.length = (rest[:, 1:] - rest[:, :-1]).norm(dim=-1).clamp(min=1e-6)
        self.tangent = tangents(rest, self.length)
        self.turn = turns(self.tangent)
        self.mean = 0.5 * (self.length[:, 1:] + self.length[:, :-1])


def stretch(x, rest):
    edge = x[..., 1:, :] - x[..., :-1, :]
    return 0.5 * STRETCH * ((edge.norm(dim=-1) - rest.length) ** 2).sum()


def bend_twist(x, rest, rotation):
    t = tangents(x, rest.length)
    frame = qmul(transport(rotate(rotation, rest.tangent[:, 0]), t[..., 0, :]), rotation)[..., None, :]
    r = turns(t)
    r = torch.cat([r[..., :1] * dot(frame, frame)[..., None], rotate(conjugate(frame), r[..., 1:])], -1)
    sign = torch.where(dot(r, rest.turn) < 0, -1.0, 1.0)[..., None]
    omega = 2 / rest.mean[..., None] * (sign * r[..., 1:] - rest.turn[..., 1:])
    return 0.5 * BEND * (rest.mean * dot(omega, omega)).sum()


def with_backward(function, leaves):
    def run():
        for leaf in leaves:
            leaf.grad = None
        loss = function()
        loss.backward()
        return loss

    return run


def variants(function, leaves, example=None):
    """Eager, and compiled where that works here."""
    found = {"eager": with_backward(function, leaves)}
    if os.environ.get("BENCH_NO_COMPILE"):
        return found
    try:
        signal.alarm(75)  # longer is not waited for
        compiled = with_backward(torch.compile(function, dynamic=False), leaves)
        compiled()
        compiled()
        found["compile"] = compiled
    except Exception as reason:  # no compiler, an old PyTorch, no time
        print(f"torch.compile: {str(reason)[:200]}", file=sys.stderr)
    finally:
        signal.alarm(0)
    return found


def energies():
    rest_groom, x, predicted = (tensor(n).float() for n in ("rest", "x", "predicted"))
    rest = Rest(rest_groom)
    x.requires_grad_()
    mass = torch.ones(rest_groom.shape[:2])
    rotation = torch.tensor([1.0, 0, 0, 0]).repeat(1, rest_groom.shape[0], 1)
    g = torch.tensor([0, -9.81, 0])

    def energy():
        gravity = -(mass * (x @ g)).sum()
        inertia = (mass * ((x - predicted) ** 2).sum(-1)).sum() / (2 * DT * DT)
        return stretch(x, rest) + bend_twist(x, rest, rotation) + gravity + inertia

    return f"PyTorch {torch.__version__}", variants(energy, [x])


def kernel(r, h):
    s = r / h
    return torch.where(s < 1, 4 - 6 * s**2 + 3 * s**3, (2 - s).clamp(min=0) ** 3)


def density(x, h):
    """Sum of W over all neighbours within 2h and the vertex itself; the list by SciPy's tree, each pair once."""
    from scipy.spatial import cKDTree

    points = x.detach().cpu().numpy()
    pairs = torch.from_numpy(cKDTree(points).query_pairs(2 * h, output_type="ndarray")).to(DEVICE)
    i, j = pairs[:, 0], pairs[:, 1]
    w = kernel((x[i] - x[j]).norm(dim=-1), h)
    return torch.full((len(points),), 4.0, dtype=x.dtype).index_add(0, i, w).index_add(0, j, w)


def self_collision():
    try:
        import scipy
    except ImportError:
        return "SciPy is not installed", {}
    rest, x = tensor("rest").reshape(-1, 3), tensor("x").reshape(-1, 3)
    h = float(array("h")[0])
    at_rest = density(rest, h).float()
    x.requires_grad_()

    def energy():
        return 1e-10 * ((density(x, h) - at_rest).clamp(min=0) ** 3).sum()

    return f"PyTorch {torch.__version__}, SciPy {scipy.__version__}", {"eager": with_backward(energy, [x])}


class Network(torch.nn.Module if "torch" in sys.modules else object):
    def __init__(self, weights):
        super().__init__()
        self.layers = torch.nn.Sequential()
        for k in range(0, len(weights), 2):
            layer = torch.nn.Linear(weights[k].shape[0], weights[k].shape[1])
            with torch.no_grad():
                layer.weight.copy_(torch.from_numpy(weights[k].T.copy()).to(DEVICE))
                layer.bias.copy_(torch.from_numpy(weights[k + 1]).to(DEVICE))
            self.layers.append(layer)
            if k + 2 < len(weights):
                self.layers.append(torch.nn.SiLU())

    def forward(self, x):
        return self.layers(x)


def network():
    p = [array(f"param{i}") for i in range(7)]
    model = Network([np.concatenate([p[0], p[1]]), p[2], p[3], p[4], p[5], p[6]])
    features = tensor("features")
    parameters = list(model.parameters())

    def loss():
        return 0.5 * model(features).square().sum()

    def half():
        with torch.autocast(DEVICE, dtype=torch.bfloat16):
            y = model(features)
        return 0.5 * y.float().square().sum()

    found = variants(loss, parameters)
    found["bf16"] = with_backward(half, parameters)
    return f"PyTorch {torch.__version__}", found


def decoder():
    functional = torch.nn.functional
    weights, biases = ([tensor(f"{what}{i}").requires_grad_() for i in range(4)] for what in ("weight", "bias"))
    latent = tensor("latent").requires_grad_()

    def decode():
        x = latent
        for i in range(4):
            if i < 3:
                x = functional.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)
            x = functional.conv2d(x, weights[i], biases[i], padding=1)
            if i < 3:
                x = functional.silu(x)
        return x

    def loss():
        return 0.5 * decode().square().sum()

    def half():
        with torch.autocast(DEVICE, dtype=torch.bfloat16):
            y = decode()
        return 0.5 * y.float().square().sum()

    parameters = [latent, *weights, *biases]
    return f"PyTorch {torch.__version__}", {"eager": with_backward(loss, parameters), "bf16": with_backward(half, parameters)}


def step():
    """A training step: the network for three frames, the gradient for the last, eight energies, Adam with clipping.
    Closest triangles by SciPy's tree over the triangles' centres, since a search over all triangles would take minutes."""
    try:
        import scipy
        from scipy.spatial import cKDTree
    except ImportError:
        return "SciPy is not installed", {}
    names = ("strand", "rest", "inputs", "rotation", "position", "body", "body_distance")
    strand, rest_groom, inputs, rotation, position, body, distance = (tensor(n) for n in names)
    faces, mass, reference = tensor("faces").long(), tensor("mass"), float(array("reference")[0])
    S, V, _ = rest_groom.shape
    rest = Rest(rest_groom)
    local = rest_groom - rest_groom[:, :1]
    ends = torch.cat([rest.length[:, :1], rest.length[:, 1:] + rest.length[:, :-1], rest.length[:, -1:]], 1)
    mass = mass.float()[:, None] * ends / ends.sum(1, keepdim=True)
    style = 0.005 * (1 - (distance.clamp(min=0) / 8e-3).clamp(max=1))
    flat = rest_groom.reshape(-1, 3)
    at_rest = density(flat, 5e-3)
    # the five nearest vertices of other strands within 4.5 mm
    away, near = cKDTree(flat.cpu().numpy()).query(flat.cpu().numpy(), k=40, distance_upper_bound=4.5e-3)
    owner = np.arange(S * V)[:, None]
    good = (near < S * V) & (np.minimum(near, S * V - 1) // V != owner // V)
    good &= np.cumsum(good, 1) <= 5
    pair_i, pair_j = (torch.from_numpy(a.copy()).to(DEVICE) for a in (np.broadcast_to(owner, near.shape)[good], near[good]))
    weights = []
    while os.path.exists(f"{folder}/model{len(weights)}.npy"):
        weights.append(array(f"model{len(weights)}"))
    model = Network(weights)
    optimiser = torch.optim.Adam(model.parameters(), lr=1e-6)
    g = torch.tensor([0, -9.81, 0])
    features = [torch.cat([strand, inputs[t].expand(S, -1)], 1) for t in range(3)]

    def place(t):
        d = 0.01 * model(features[t]).reshape(S, V - 1, 3)
        moved = torch.cat([local[:, :1], local[:, 1:] + d], 1)
        return position[t][:, None] + rotate(rotation[t][:, None], moved)

    def contact(x, centres):
        p = x.detach()
        triangle = torch.from_numpy(centres.query(p.cpu().numpy())[1]).to(DEVICE)
        a, b, c = (body[faces[triangle, k]] for k in range(3))
        n = cross(b - a, c - a)
        n = n / n.norm(dim=-1, keepdim=True).clamp(min=1e-12)
        return dot(n, x - a)

    def loss():
        with torch.no_grad():
            before, previous = place(0), place(1)
            predicted = 2 * previous - before
            posed = position[2][:, None] + rotate(rotation[2][:, None], local)
        x = place(2)
        points = x.reshape(-1, 3)
        centres = cKDTree(body[faces].mean(1).cpu().numpy())
        energy = stretch(x, rest) + bend_twist(x, rest, rotation[2])
        energy = energy - (mass * (x @ g)).sum() + (mass * ((x - predicted) ** 2).sum(-1)).sum() / (2 * DT * DT)
        energy = energy + 30 * ((5e-3 - contact(points, centres)).clamp(min=0) ** 3).sum()
        energy = energy + (style * ((x - posed) ** 2).sum(-1)).sum()
        energy = energy + 1e-10 * ((density(points, 5e-3) - at_rest).clamp(min=0) ** 3).sum()
        energy = energy + 1e-6 * ((points[pair_i] - points[pair_j]) ** 2).sum()
        return energy / (S * reference)

    def run():
        optimiser.zero_grad(set_to_none=True)
        loss().backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimiser.step()

    memory["before"] = resident("VmRSS")
    return f"PyTorch {torch.__version__}, SciPy {scipy.__version__}", {"eager": run}


def resident(key):
    for line in open("/proc/self/status"):
        if line.startswith(key):
            return 1024 * int(line.split()[1])
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


memory = {}
text, sides = {"energies": energies, "self_collision": self_collision, "network": network, "decoder": decoder, "step": step,
               "inference": inference}[row]()
if not sides:
    say(f"none {text}")
    sys.exit()
if row == "step":  # what the step takes beyond what stands ready before it
    open("/proc/self/clear_refs", "w").write("5")
    memory["before"] = resident("VmRSS")
for side in sides.values():
    side()
say(f"ready {' '.join(sides)} | {text}")
for line in sys.stdin:
    words = line.split()
    if words[0] == "quit":
        break
    if words[0] == "memory":
        say(str(resident("VmHWM") - memory.get("before", 0)))
        continue
    side, times = sides[words[1]], []
    wait = torch.cuda.synchronize if DEVICE == "cuda" and row != "inference" else lambda: None
    side()
    for _ in range(int(words[2])):
        wait()
        start = time.perf_counter()
        side()
        wait()
        times.append(1e3 * (time.perf_counter() - start))
    say(" ".join(f"{t:.4f}" for t in times))
