# Exported files as others read them: ONNX by the onnx checker and ONNX Runtime, VTKHDF by VTK. Needs Python packages
# that hairgrad itself does not: without them the test is skipped. HG_PYTHON names the interpreter (default python3).
build=${1:-build}
python=${HG_PYTHON:-python3}
if ! "$python" -c 'import h5py, numpy, onnx, onnxruntime' 2>/dev/null; then
    echo "skipped: $python has not all of h5py, numpy, onnx and onnxruntime (HG_PYTHON names another interpreter)"
    exit 77
fi
folder=$(mktemp -d) || exit 1
trap 'rm -rf "$folder"' EXIT
HG_ONNX_DUMP=$folder "$build/tests/test_onnx" || exit 1

# A hair network, hardly trained: what it answers natively stands in the HDF5 export.
cat > "$folder/tiny.yaml" <<END
scene: { strands: 80, vertices: 12, seconds: 1 s, motion_kinds: [turn], held_out_kinds: [shake] }
model: { width: 16 }
features: { history: 3, latent: 4, lock_size: 8, encoder_width: 16, encoder_steps: 20 }
losses: { stretch: {}, gravity: {}, inertia: {} }
training: { strands: 32, steps: 20, learning_rate: 1e-2, warm_up: 2, validate_every: 0, checkpoint_every: 0 }
END
"$build/hairgrad" train "$folder/tiny.yaml" -o "$folder/run" 2> "$folder/log" || { cat "$folder/log"; exit 1; }
"$build/hairgrad" export "$folder/run" --to onnx -o "$folder/hair.network" || exit 1
"$build/hairgrad" export "$folder/run" --to h5 -o "$folder/hair.h5" || exit 1
mkdir "$folder/parts" || exit 1
"$build/hairgrad" export "$folder/run" --form factored -o "$folder/parts/vertices.onnx" || exit 1
sed 's/width: 16 }/width: 16, output: directions, pinned: 2 }/' "$folder/tiny.yaml" > "$folder/turn.yaml"
"$build/hairgrad" train "$folder/turn.yaml" -o "$folder/turn" 2> "$folder/log" || { cat "$folder/log"; exit 1; }
"$build/hairgrad" export "$folder/turn" --to h5 -o "$folder/turn.h5" || exit 1
"$build/hairgrad" export "$folder/turn" --form factored -o "$folder/parts/directions.onnx" || exit 1
# A network of grooms: images, and the strands of one of the grooms and of one that was not trained on.
cat > "$folder/grooms.yaml" <<END
scene: { grooms: [wavy, short], strands: 80, vertices: 12, seconds: 1 s, motion_kinds: [turn], held_out_kinds: [shake] }
model: { kind: quaffure, texture: 16, width: 16, depth: 2 }
features: { history: 2, latent: 4, encoder_width: 8, encoder_steps: 20 }
losses: { stretch: {}, gravity: {}, inertia: {} }
training: { strands: 32, steps: 20, learning_rate: 1e-2, warm_up: 2, validate_every: 0, checkpoint_every: 0 }
END
"$build/hairgrad" train "$folder/grooms.yaml" -o "$folder/grooms" 2> "$folder/log" || { cat "$folder/log"; exit 1; }
for groom in wavy short curly; do
    mkdir "$folder/$groom" || exit 1
    "$build/hairgrad" export "$folder/grooms" --groom $groom --to h5 -o "$folder/$groom/network.h5" || exit 1
    for form in image strands; do "$build/hairgrad" export "$folder/grooms" --groom $groom --form $form -o "$folder/$groom/$form.onnx" || exit 1; done
done
"$python" "$HG_SOURCE/tests/reference/check_exports.py" "$folder"
