# Exported files as others read them: ONNX by the onnx checker and ONNX Runtime, VTKHDF by VTK. Needs Python packages
# that hairgrad itself does not: without them the test is skipped. HG_PYTHON names the interpreter (default python3).
build=${1:-build}
python=${HG_PYTHON:-python3}
if ! "$python" -c 'import numpy, onnx, onnxruntime, vtk' 2>/dev/null; then
    echo "skipped: $python has not all of numpy, onnx, onnxruntime and vtk (HG_PYTHON names another interpreter)"
    exit 77
fi
folder=$(mktemp -d) || exit 1
trap 'rm -rf "$folder"' EXIT
HG_ONNX_DUMP=$folder "$build/tests/test_onnx" || exit 1
"$python" "$HG_SOURCE/tests/reference/check_exports.py" "$folder"
