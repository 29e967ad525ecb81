"""Systems with weights of the user: files of PyTorch, LENS, ONNX models; and ensembles."""

from __future__ import annotations

import math

import numpy as np
import pytest
from lab.baselines import Ensemble, Member, compare, match_distances, open_baseline
from lab.baselines.dense import AbsoluteDifferences, PatchNormalised, mean_cells
from lab.baselines.networks import (
    Lens,
    LensWeights,
    WeightsError,
    grid_pixels,
    load_lens,
    read_state_dict,
)

from edge_vpr.errors import UsageError
from tests.lab.test_baselines import SETTINGS, places_of

# --- weights --------------------------------------------------------------------------------------


def state_file(path, tensors):
    """Write tensors as safetensors."""
    numpy = pytest.importorskip("safetensors.numpy", reason="safetensors is not installed (models)")
    numpy.save_file(tensors, path)
    return path


TENSORS = {
    "a.weight": np.arange(12, dtype=np.float32).reshape(3, 4),
    "b": np.arange(-4, 4).reshape(2, 2, 2),
    "c": np.array([True, False]),
}


def assert_whole(loaded):
    assert loaded.keys() == TENSORS.keys()
    for name, tensor in TENSORS.items():
        assert loaded[name].dtype == tensor.dtype and np.array_equal(loaded[name], tensor)


def test_a_file_of_safetensors_is_read_as_it_was_written(tmp_path):
    assert_whole(read_state_dict(state_file(tmp_path / "a.safetensors", TENSORS)))


def test_a_state_dict_of_torch_is_read_without_running_what_it_holds(tmp_path):
    torch = pytest.importorskip("torch", reason="torch is not installed (extra torch)")
    state = {name: torch.from_numpy(tensor) for name, tensor in TENSORS.items()}
    torch.save(state, tmp_path / "a.pth")
    assert_whole(read_state_dict(tmp_path / "a.pth"))
    torch.save(torch.nn.Linear(5, 3), tmp_path / "b.pth")  # a whole model needs its code
    with pytest.raises(WeightsError, match="damaged, or no state dict"):
        read_state_dict(tmp_path / "b.pth")
    torch.save([1, 2], tmp_path / "c.pth")
    with pytest.raises(WeightsError, match="holds a list and no state dict"):
        read_state_dict(tmp_path / "c.pth")
    torch.save({"a": 1}, tmp_path / "d.pth")
    with pytest.raises(WeightsError, match="holds no tensors"):
        read_state_dict(tmp_path / "d.pth")


# --- LENS -----------------------------------------------------------------------------------------


def naive_lens(images, feature, output, steps, thresholds, seed, side):
    """One neuron after another, one step after another, as the network is described."""
    _, height, width = images.shape
    cell = min(height, width) // side
    draws = np.random.default_rng(seed).random((steps, side * side), np.float32)
    v_feature, v_output = [0.0] * len(feature), [0.0] * len(output)
    rows = []
    for image in images.tolist():
        pixels = []
        for row in range(side):
            for column in range(side):
                y = (height - side * cell) // 2 + row * cell + max(cell // 2 - 1, 0)
                x = (width - side * cell) // 2 + column * cell + max(cell // 2 - 1, 0)
                pixels.append(np.float32(min(image[y][x], 255)) / np.float32(255))
        counts = [0] * len(output)
        for step in range(steps):
            spikes = [int(draws[step, i] < share) for i, share in enumerate(pixels)]
            for weights, membranes, threshold, last in (
                (feature, v_feature, thresholds[0], False),
                (output, v_output, thresholds[1], True),
            ):
                fired = []
                for n, own in enumerate(weights):
                    membranes[n] += sum(w * s for w, s in zip(own, spikes, strict=True))
                    fires = int(membranes[n] / threshold) if membranes[n] > 0 else 0
                    membranes[n] = max(membranes[n] - fires * threshold, -1.0)
                    fired.append(fires)
                    if last:
                        counts[n] += fires
                spikes = fired
        rows.append(counts)
    return rows


def lens_weights(rng):
    """Weights in 64ths, of which sums are exact in float32, of 3 x 3 pixels and five places."""
    shapes = (7, 9), (5, 7)
    return LensWeights(*((rng.integers(-40, 60, s) / 64).astype(np.float32) for s in shapes))


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("thresholds", [(1.0, 1.0), (2.5, 2.0)])
def test_lens_spikes_as_its_loop_does(seed, thresholds):
    rng = np.random.default_rng(seed)
    weights = lens_weights(rng)
    images = rng.integers(0, 300, (4, *rng.integers(3, 20, 2)))
    spikes = Lens(weights, seed, steps=25, thresholds=thresholds).describe(images)
    layers = (weights.feature.tolist(), weights.output.tolist())
    expected = naive_lens(images, *layers, 25, thresholds, seed, 3)
    assert spikes.tolist() == expected and np.any(spikes)


def test_lens_with_weights_of_a_file_finds_the_place_with_the_most_spikes(tmp_path):
    """Of a network in which each place's neuron adds what its own pixels say."""
    side, places = 4, 8
    feature = np.eye(side * side, dtype=np.float32)
    output = np.zeros((places, side * side), np.float32)
    images = np.zeros((places, 16, 16), np.uint16)
    for place in range(places):
        shown = [place, place + 8]
        output[place, shown] = 0.5
        for pixel in shown:
            images[place, pixel // side * 4 + 1, pixel % side * 4 + 1] = 200
    path = state_file(
        tmp_path / "x_LENS_IN16_FN16_DB8.safetensors",
        {"feature_layer.thr": np.zeros(1, "<f4"), "feature_layer.w.weight": feature,
         "output_layer.w.weight": output},
    )  # fmt: skip
    baseline = open_baseline(f"lens:{path}", 4)
    compared = compare(baseline, images, images)
    assert np.array_equal(compared.distances.argmin(axis=0), np.arange(places))
    assert compared.bytes_per_place == 4 * (feature.size + output.size) // places
    assert compared.operations == 1000 * (feature.size + output.size)
    with pytest.raises(UsageError, match="of 8 places, and the reference has 7 windows"):
        baseline.prepare(images[:7])
    with pytest.raises(UsageError, match="images of 3x3 pixels for weights of a grid of 4x4"):
        grid_pixels(images[:, :3, :3], 4)


def test_weights_that_are_not_of_lens_are_refused(tmp_path):
    good = lens_weights(np.random.default_rng(0))
    names = ("feature_layer.w.weight", "output_layer.w.weight")
    narrow = good.feature[:, :8].copy()
    infinite = np.full_like(good.feature, np.inf)
    for layers, says in (
        ((good.feature, good.feature), r"layers of shape \(7, 9\) and \(7, 9\)"),
        ((narrow, good.output), r"layers of shape \(7, 8\) and \(5, 7\).*side \* side"),
        ((infinite, good.output), "weights that are not finite"),
    ):
        with pytest.raises(WeightsError, match=says):
            load_lens(state_file(tmp_path / "a.safetensors", dict(zip(names, layers, strict=True))))
    with pytest.raises(WeightsError, match=r"no feature_layer\.w\.weight and no output.*it has w"):
        load_lens(state_file(tmp_path / "a.safetensors", {"w": good.feature}))
    with pytest.raises(UsageError, match="'lens' needs a file: write lens:FILE"):
        open_baseline("lens")


# --- models in ONNX -------------------------------------------------------------------------------


def onnx_model(path, weights, shape, kind=1):
    """Write a model that flattens images and multiplies them with a matrix."""
    onnx = pytest.importorskip("onnx", reason="onnx is not installed (extra test)")
    from onnx import helper, numpy_helper

    nodes = [
        helper.make_node("Flatten", ["images"], ["flat"]),
        helper.make_node("MatMul", ["flat", "weights"], ["vectors"]),
    ]
    graph = helper.make_graph(
        nodes, "tiny",
        [helper.make_tensor_value_info("images", kind, shape)],
        [helper.make_tensor_value_info("vectors", kind, [None, weights.shape[1]])],
        [numpy_helper.from_array(weights, "weights")],
    )  # fmt: skip
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    onnx.save(model, str(path))
    return path


@pytest.fixture
def _runtime():
    pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra lab)")


@pytest.mark.usefixtures("_runtime")
@pytest.mark.parametrize("batch", ["n", 1, 5])
def test_a_model_describes_scaled_images_in_any_batch(batch, tmp_path):
    rng = np.random.default_rng(1)
    weights = rng.normal(size=(3 * 4 * 6, 10)).astype(np.float32)
    path = onnx_model(tmp_path / "tiny.onnx", weights, [batch, 3, 4, 6])
    baseline = open_baseline(f"model:{path}")
    assert baseline.title == "tiny, cosine"
    counts = rng.integers(0, 50, (11, 8, 12)).astype(np.uint16)
    counts[4] = 0
    cells = counts.reshape(11, 4, 2, 6, 2).mean(axis=(2, 4))
    most = np.log1p(cells).max(axis=(1, 2), keepdims=True)
    scaled = np.log1p(cells) / np.where(most > 0, most, 1)
    grey = rng.integers(0, 256, (11, 4, 6)).astype(np.uint8)
    for images, values in ((counts, scaled), (grey, grey / 255)):
        inputs = np.repeat(values[:, None], 3, axis=1).reshape(11, -1)
        described = baseline.describe(images)
        assert described == pytest.approx(inputs.astype(np.float32) @ weights, abs=1e-4)
        assert (
            baseline.bits_per_place(described) == 320
            and baseline.operations_per_place(described) == 10
        )
    distances = baseline.distances(described, described)
    a, b = described[2].tolist(), described[7].tolist()
    product = sum(x * y for x, y in zip(a, b, strict=True))
    scale = math.hypot(*a) * math.hypot(*b)
    assert distances[2, 7] == pytest.approx(1 - product / scale)


@pytest.mark.usefixtures("_runtime")
def test_a_model_of_random_weights_finds_places_alone_and_in_an_ensemble(tmp_path):
    rng = np.random.default_rng(2)
    weights = rng.normal(size=(256, 64)).astype(np.float32)
    path = onnx_model(tmp_path / "tiny.onnx", weights, ["n", 1, 16, 16])
    reference = places_of(rng)
    queries = rng.binomial(reference, 0.9).astype(np.uint16)
    for name in (f"model:{path}", f"model:{path}@1,2", f"model:{path}+patch-normalised"):
        compared = compare(open_baseline(name), reference, queries)
        matches = match_distances(compared.distances, np.arange(12), SETTINGS)
        assert np.array_equal(matches.place, matches.query), name


@pytest.mark.usefixtures("_runtime")
def test_a_file_that_is_no_model_of_images_is_refused(tmp_path):
    (tmp_path / "text.onnx").write_text("no model")
    square = np.eye(4, dtype=np.float32)
    flat = onnx_model(tmp_path / "flat.onnx", square, ["n", 4])
    double = onnx_model(tmp_path / "double.onnx", square.astype(float), ["n", 1, 2, 2], kind=11)
    broken = onnx_model(tmp_path / "nan.onnx", square * np.float32(np.nan), ["n", 1, 2, 2])
    for path, says in (
        (tmp_path / "none.onnx", "cannot be read: No such file"),
        (tmp_path / "text.onnx", "no model that ONNX Runtime reads"),
        (flat, r"takes images tensor\(float\) \['n', 4\]: export a model of one input"),
        (double, r"tensor\(double\)"),
    ):
        with pytest.raises(WeightsError, match=says):
            open_baseline(f"model:{path}")
    with pytest.raises(WeightsError, match="values that are not finite"):
        open_baseline(f"model:{broken}").describe(np.ones((1, 2, 2), np.uint8))


# --- ensembles ------------------------------------------------------------------------------------


def test_an_ensemble_is_the_mean_of_its_members_scaled_distances():
    rng = np.random.default_rng(4)
    reference, queries = places_of(rng, 6), places_of(rng, 5)
    ensemble = Ensemble("two", [Member(AbsoluteDifferences(), 3), Member(PatchNormalised())])
    ensemble.prepare(reference)
    places, described = ensemble.describe(reference), ensemble.describe(queries)
    wanted = np.zeros((6, 5))
    for baseline, windows in ((AbsoluteDifferences(), 3), (PatchNormalised(), 1)):
        shown = []
        for images in (reference, queries):
            n = len(images)
            half = windows // 2
            rows = [
                sum(
                    images[min(max(k, 0), n - 1)].astype(int) for k in range(i - half, i + half + 1)
                )
                for i in range(n)
            ]
            shown.append(baseline.describe(np.array(rows)))
        between = baseline.distances(shown[0], shown[0])
        scale = sum(between[i, k] for i in range(6) for k in range(6) if i != k) / 30
        wanted += baseline.distances(*shown) / scale / 2
    assert ensemble.distances(places, described) == pytest.approx(wanted)
    assert ensemble.bits_per_place(places) == 8 * (1024 + 128 * 128)
    assert ensemble.operations_per_place(places) == 1024 + 128 * 128
    assert len(ensemble.describe(queries[:1])) == 1


def test_a_name_says_windows_and_members_of_an_ensemble():
    baseline = open_baseline("patch-normalised@1,2,4")
    members = [Member(PatchNormalised(), windows) for windows in (1, 2, 4)]
    own = Ensemble("own", members)
    images = places_of(np.random.default_rng(5), 5)
    for one in (baseline, own):
        one.prepare(images)
    a, b = (one.distances(one.describe(images), one.describe(images)) for one in (baseline, own))
    assert np.array_equal(a, b)
    with pytest.raises(UsageError, match=r"\[0\] windows: give one member or more"):
        open_baseline("all-pixels@0")
    with pytest.raises(UsageError, match=r"'hoq' is unknown.*did you mean hog.*lens:FILE"):
        open_baseline("all-pixels+hoq")
    with pytest.raises(UsageError, match="give one member or more"):
        Ensemble("none", [])


def test_cells_of_a_grid_that_is_not_square_hold_means():
    images = np.arange(24).reshape(1, 4, 6)
    assert mean_cells(images, 2, 3)[0].tolist() == [[3.5, 5.5, 7.5], [15.5, 17.5, 19.5]]
