"""Reads what tests/test_onnx wrote into a folder with the tools of others: onnx, ONNX Runtime, VTK."""
import glob
import json
import os
import sys

import h5py
import numpy as np
import onnx
import onnxruntime

try:
    import vtk
    from vtk.util.numpy_support import vtk_to_numpy
except ImportError:
    vtk = None

folder = sys.argv[1]
worst = 0.0
models = sorted(glob.glob(os.path.join(folder, "*.onnx")))
assert models, "no models"
for path in models:
    model = onnx.load(path)
    onnx.checker.check_model(model, full_check=True)
    assert model.ir_version == 7 and model.opset_import[0].version == 15
    assert {p.key: p.value for p in model.metadata_props}["units"] == "metres"
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    for rows in (1, 7):
        stem = f"{path[:-5]}.{rows}"
        x = np.fromfile(stem + ".in", np.float32).reshape(rows, -1)
        expected = np.fromfile(stem + ".out", np.float32)
        found = session.run(None, {"features": x})[0]
        assert found.shape[0] == rows and found.size == expected.size, (stem, found.shape, expected.size)
        error = np.abs(found.ravel() - expected).max() / max(1.0, np.abs(expected).max())
        worst = max(worst, error)
        assert error < 1e-5, f"{stem}: differs by {error:g}"
print(f"{len(models)} models, 1 and 7 rows: ONNX Runtime {onnxruntime.__version__} differs by at most {worst:.2g}")

path = os.path.join(folder, "hair.network")
model = onnx.load(path)
onnx.checker.check_model(model, full_check=True)
about = {p.key: p.value for p in model.metadata_props}
session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
with h5py.File(os.path.join(folder, "hair.h5")) as weights:
    x, expected = weights["sample/features"][:], weights["sample/displacement"][:]
    columns = json.loads(about["features"])
    assert sum(c["count"] for c in columns) == x.shape[1]
    assert [c["name"] for c in columns] == [n.decode() for n in weights["features/name"][:]]
    for key in ("groom_hash", "body_hash", "dt", "vertices"):
        assert about[key] == weights.attrs[key].decode(), key
assert expected.shape[1] == 3 * (int(about["vertices"]) - 1) and np.abs(expected).max() > 1e-6
error = np.abs(session.run(None, {"features": x})[0] - expected).max()
assert error < 1e-5, f"hair network: differs by {error:g} m"
print(f"hair network: ONNX Runtime differs by at most {error:.2g} m of {np.abs(expected).max():.2g} m")

for name, source in (("vertices", "hair.h5"), ("directions", "turn.h5")):
    parts = []
    for half in ("strand", "frame"):
        path = os.path.join(folder, "parts", f"{name}.{half}.onnx")
        onnx.checker.check_model(onnx.load(path), full_check=True)
        parts.append(onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"]))
    with h5py.File(os.path.join(folder, source)) as weights:
        x, expected = weights["sample/features"][:], weights["sample/displacement"][:]
    inputs = {i.name: i for i in parts[1].get_inputs()}
    own, frame = parts[0].get_inputs()[0].shape[1], inputs["frame_features"].shape[1]
    part = parts[0].run(None, {"strand_features": x[:, :own]})[0]
    frames = np.stack([x[0, -frame:], 0.5 * x[0, -frame:], x[0, -frame:]])
    feed = {"part": part, "frame_features": frames}
    if "rest" in inputs:
        feed["rest"] = x[:, own:-frame]
    found = parts[1].run(None, feed)[0]
    assert found.shape == (3,) + expected.shape, found.shape
    assert np.array_equal(found[0], found[2]) and np.abs(found[0] - found[1]).max() > 1e-6
    error = np.abs(found[0] - expected).max()
    assert error < 1e-5, f"{name}, in two parts: differs by {error:g} m"
    print(f"{name}, in two parts: ONNX Runtime differs by at most {error:.2g} m of {np.abs(expected).max():.2g} m")

for groom in ("wavy", "short", "curly"):
    sessions, about = {}, {}
    for form in ("image", "strands"):
        path = os.path.join(folder, groom, form + ".onnx")
        model = onnx.load(path)
        onnx.checker.check_model(model, full_check=True)
        about = {p.key: p.value for p in model.metadata_props}
        assert about["form"] == form
        sessions[form] = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    side, texel, strand = int(about["texture"]), json.loads(about["texel"]), json.loads(about["strand"])
    with h5py.File(os.path.join(folder, groom, "network.h5")) as weights:
        x, expected = weights["sample/features"][:], weights["sample/displacement"][:]
        assert weights["texture/texel"][:].tolist() == texel and weights["texture/strand"][:].tolist() == strand
    columns = json.loads(about["features"])
    assert [c["name"] for c in columns[:4]] == ["z_groom[%d]" % i for i in range(4)]
    assert sum(c["count"] for c in columns) == x.shape[1]
    assert len(texel) == len(set(texel)) == len(strand) == int(about["strands"]) == 80 - int(about["strands_left_out"])
    assert strand == sorted(strand) and strand[-1] < 80 and max(texel) < side * side
    for rows in (1, 4):
        images = sessions["image"].run(None, {"features": x[:rows]})[0]
        strands = sessions["strands"].run(None, {"features": x[:rows]})[0]
        assert images.shape == (rows, 33, side, side) and strands.shape == (rows, len(texel), 33)
        picked = images.reshape(rows, 33, side * side)[:, :, texel].transpose(0, 2, 1)
        error = max(np.abs(images - expected[:rows]).max(), np.abs(strands - picked).max())
        assert np.abs(expected).max() > 1e-6 and error < 1e-5, f"{groom}: differs by {error:g} m"
    print(f"images of {groom}: ONNX Runtime differs by at most {error:.2g} m of {np.abs(expected).max():.2g} m")

if not vtk:
    print("skip VTKHDF by VTK (it is not here)")
    sys.exit(0)
for name, cells in (("strands", 4), ("mesh", 2)):
    reader = vtk.vtkHDFReader()
    path = os.path.join(folder, name + ".vtkhdf")
    assert reader.CanReadFile(path)
    reader.SetFileName(path)
    reader.UpdateInformation()
    assert reader.GetNumberOfSteps() == 5
    for step in range(5):
        reader.SetStep(step)
        reader.Update()
        data = reader.GetOutputDataObject(0)
        points = vtk_to_numpy(data.GetPoints().GetData())
        assert np.array_equal(points.ravel(), 1000 * step + np.arange(points.size)), (name, step)
        assert abs(reader.GetTimeValue() - step / 30) < 1e-9
        assert data.GetNumberOfCells() == cells
        if name == "strands":
            assert data.GetNumberOfLines() == 4 and points.shape == (12, 3)
            assert np.array_equal(vtk_to_numpy(data.GetPointData().GetArray("strand")), np.repeat(np.arange(4), 3))
            assert np.array_equal(vtk_to_numpy(data.GetPointData().GetArray("along")), np.tile([0, 0.5, 1], 4))
print(f"VTK {vtk.vtkVersion().GetVTKVersion()} reads every step of strands and mesh")
