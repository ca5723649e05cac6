"""Writes the tiny model folders that the SDK's tests run: `make_test_models.py FOLDER`. Weights come from a seed."""

import hashlib
import json
import sys
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

Shape = list[int | str]
BUFFERS: dict[str, Shape] = {
    "radiance": [1, 3, "H", "W"],
    "variance": [1, 3, "H", "W"],
    "albedo": [1, 3, "H", "W"],
    "normal": [1, 3, "H", "W"],
    "depth": [1, 1, "H", "W"],
    "diffuse.albedo": [1, 3, "H", "W"],
    "samples.descriptor": ["S", 36, "H", "W"],
    "samples.density": ["S", 1, "H", "W"],
    "samples.valid": ["S", 1, "H", "W"],
    "exposure": [1],
    "depth_scale": [1],
    "variance.present": [1],
    "albedo.present": [1],
    "normal.present": [1],
    "depth.present": [1],
    "split.present": [1],
}


def make_graph(inputs: list[str], taps: int, seed: int, spread: float = 1.0, int8: bool = False) -> onnx.ModelProto:
    """logits = 3x3 convolution of log(1 + exposure * radiance), every other image squashed, and sample means.

    With `int8` both sides of the convolution are rounded to 8 bits.
    """
    rng = np.random.default_rng(seed)
    nodes, initializers, features, width = [], [], [], 0

    def constant(name: str, values: object) -> str:
        initializers.append(numpy_helper.from_array(np.asarray(values), name))
        return name

    one = constant("one", np.float32(1))
    for name in inputs:
        shape = BUFFERS[name]
        out = name + ":feature"
        if len(shape) == 1:
            continue
        if name == "radiance":
            nodes.append(helper.make_node("Mul", [name, "exposure"], ["exposed"]))
            nodes.append(helper.make_node("Add", ["exposed", one], ["above"]))
            nodes.append(helper.make_node("Log", ["above"], [out]))
        elif name.startswith("samples."):
            nodes.append(helper.make_node("Tanh", [name], [name + ":squashed"]))
            nodes.append(helper.make_node("ReduceMean", [name + ":squashed", constant(name + ":axes", [0])], [out]))
        else:
            nodes.append(helper.make_node("Tanh", [name], [out]))
        features.append(out)
        width += int(shape[1])
    nodes.append(helper.make_node("Concat", features, ["features"], axis=1))
    weights = rng.normal(0, spread / np.sqrt(9 * width), (taps, width, 3, 3)).astype(np.float32)
    convolved = ["features", constant("weights", weights)]
    if int8:
        scales = np.abs(weights).max((1, 2, 3)) / np.float32(127)
        constant("weights:bytes", np.rint(weights / scales[:, None, None, None]).astype(np.int8))
        constant("weights:scales", scales)
        constant("weights:zeros", np.zeros(taps, np.int8))
        step = [constant("step", np.float32(4 / 255)), constant("zero", np.uint8(0))]  # features to 4
        rounded = ["features:bytes", "features:rounded", "weights:rounded"]
        nodes.append(helper.make_node("QuantizeLinear", ["features", *step], rounded[:1]))
        nodes.append(helper.make_node("DequantizeLinear", [rounded[0], *step], rounded[1:2]))
        of_weights = [f"weights:{part}" for part in ("bytes", "scales", "zeros")]
        nodes.append(helper.make_node("DequantizeLinear", of_weights, rounded[2:], axis=0))
        convolved = rounded[1:]
    nodes.append(helper.make_node("Conv", convolved, ["plain"], pads=[1, 1, 1, 1]))
    last = "plain"
    for name in inputs:  # scalars shift the logits of some taps, so that they matter
        if len(BUFFERS[name]) > 1 or name == "exposure":
            continue
        slope = rng.normal(0, 0.3, (1, taps, 1, 1)).astype(np.float32)
        nodes.append(helper.make_node("Tanh", [name], [name + ":bounded"]))
        nodes.append(helper.make_node("Mul", [name + ":bounded", constant(name + ":slope", slope)], [name + ":shift"]))
        nodes.append(helper.make_node("Add", [last, name + ":shift"], [name + ":sum"]))
        last = name + ":sum"
    nodes.append(helper.make_node("Identity", [last], ["logits"]))
    ports = [helper.make_tensor_value_info(name, TensorProto.FLOAT, BUFFERS[name]) for name in inputs]
    result = helper.make_tensor_value_info("logits", TensorProto.FLOAT, [1, taps, "H", "W"])
    graph = helper.make_graph(nodes, "network", ports, [result], initializers)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    onnx.checker.check_model(model)
    return model


def make_pyramid_graph(inputs: list[str], outputs: dict[str, Shape], seed: int) -> onnx.ModelProto:
    """Each output is a convolution of log(1 + exposure * radiance), padded to multiples of 16, as wide as its step."""
    rng = np.random.default_rng(seed)
    nodes, initializers = [], []

    def node(kind: str, *ports: str, **attributes: object) -> str:
        nodes.append(helper.make_node(kind, list(ports), [f"{kind}:{len(nodes)}"], **attributes))
        return str(nodes[-1].output[0])

    def constant(values: object) -> str:
        initializers.append(numpy_helper.from_array(np.asarray(values), f"constant:{len(initializers)}"))
        return str(initializers[-1].name)

    features = node("Log", node("Add", node("Mul", "radiance", "exposure"), constant(np.float32(1))))
    size = node("Slice", node("Shape", "radiance"), constant([2]), constant([4]))
    missing = node("Mod", node("Sub", constant([0, 0]), size), constant([16]))
    padded = node("Pad", features, node("Concat", constant([0] * 6), missing, axis=0))
    for name, shape in outputs.items():
        step = int(str(shape[2]).removeprefix("H/"))
        weights = rng.normal(0, 1 / step, (int(shape[1]), 3, step, step)).astype(np.float32)
        last = node("Conv", padded, constant(weights), strides=[step, step])
        nodes.append(helper.make_node("Identity", [last], [name]))
    ports = [helper.make_tensor_value_info(name, TensorProto.FLOAT, BUFFERS[name]) for name in inputs]
    results = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [None] * 4) for name in outputs]
    graph = helper.make_graph(nodes, "network", ports, results, initializers)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    onnx.checker.check_model(model)
    return model


def write_model(
    folder: Path,
    graphs: dict[str, tuple[onnx.ModelProto, list[str]]],
    branches: list[dict[str, object]],
    size: int,
    requires: list[str],
    uses: list[str],
    trust: bool = False,
) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    entries = {}
    for name, (model, inputs) in graphs.items():
        data = model.SerializeToString()
        (folder / f"{name}.onnx").write_bytes(data)
        entries[name] = {
            "file": f"{name}.onnx",
            "sha256": hashlib.sha256(data).hexdigest(),
            "inputs": {key: BUFFERS[key] for key in inputs},
            "outputs": {"logits": [1, size * size + trust, "H", "W"]},
        }
    manifest = {
        "format": 1,
        "name": folder.name,
        "description": "random weights, for tests",
        "license": "Apache-2.0",
        "requires": requires,
        "uses": uses,
        "graphs": entries,
        "reconstruction": {"operator": "gather", "size": size, "trust": trust, "branches": branches},
        "exposure": {"rule": "log-average", "key": 0.18},
        "tile": {"alignment": 4, "overlap": 4},
        "samples_per_pixel": {"min": 1, "max": 64},
        "precision": "fp32",
        "training": {},
    }
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=2))


def make_single(folder: Path, size: int, spread: float = 1.0, trust: bool = False) -> None:
    """One branch that reads color alone."""
    inputs = ["radiance", "exposure"]
    branch = {"name": "color", "graph": "color", "radiance": "color", "unsplit": True}
    graphs = {"color": (make_graph(inputs, size * size + trust, seed=size, spread=spread), inputs)}
    write_model(folder, graphs, [branch], size, ["color"], [], trust)


def make_greedy(folder: Path) -> None:
    """single-3, but its logits wait for the sum of radiance doubled 20 times, which no memory holds."""
    inputs = ["radiance", "exposure"]
    network = make_graph(inputs, 9, seed=3)
    last = network.graph.node.pop()
    for step in range(20):
        before = f"doubled.{step}" if step else "radiance"
        network.graph.node.append(helper.make_node("Concat", [before, before], [f"doubled.{step + 1}"], axis=0))
    network.graph.node.append(helper.make_node("ReduceSum", ["doubled.20"], ["all"], keepdims=0))
    network.graph.node.append(helper.make_node("Add", [last.input[0], "all"], ["logits"]))
    branch = {"name": "color", "graph": "color", "radiance": "color", "unsplit": True}
    write_model(folder, {"color": (network, inputs)}, [branch], 3, ["color"], [])


def make_split(folder: Path, size: int, samples: bool) -> None:
    """Two branches that read every buffer there is."""
    inputs = [name for name in BUFFERS if samples or not name.startswith("samples.")]
    branches: list[dict[str, object]] = [
        {
            "name": "diffuse",
            "graph": "diffuse",
            "radiance": "diffuse",
            "demodulate": {"by": "diffuse.albedo", "epsilon": 0.00316},
        },
        {"name": "specular", "graph": "specular", "radiance": "specular", "unsplit": True},
    ]
    graphs = {
        name: (make_graph(inputs, size * size, seed), inputs) for seed, name in enumerate(["diffuse", "specular"])
    }
    uses = ["diffuse", "specular", "diffuse.albedo", "albedo", "normal", "depth"]
    uses += ["variance", "diffuse.variance", "specular.variance"]
    requires = ["color"]
    if samples:
        requires += ["samples.descriptor", "samples.density"]
        uses.append("samples.valid")
    write_model(folder, graphs, branches, size, requires, uses)


def make_pyramid(folder: Path) -> None:
    """A pyramid that divides by an albedo, which it cleans."""
    inputs = ["radiance", "exposure"]
    sizes = {"trust.2": 4, "logits.2": 150, "logits.4": 30, "logits.8": 30, "logits.16": 25}
    sizes |= {"cleaning.2": 150, "cleaning.4": 25}
    outputs: dict[str, Shape] = {}
    for name, channels in sizes.items():
        step = name.rpartition(".")[2]
        outputs[name.replace("trust.2", "trust")] = [1, channels, f"H/{step}", f"W/{step}"]
    demodulate = {"by": "albedo", "epsilon": 0.01, "clean": True}
    branch = {"name": "color", "graph": "color", "radiance": "color", "demodulate": demodulate, "unsplit": True}
    write_model(folder, {"color": (make_pyramid_graph(inputs, outputs, 7), inputs)}, [branch], 1, ["color"], ["albedo"])
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["reconstruction"] = {"operator": "pyramid", "branches": [branch]}
    manifest["graphs"]["color"]["outputs"] = outputs
    manifest["tile"] = {"alignment": 16, "overlap": 80}
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=2))


def make_quantised(folder: Path, size: int) -> None:
    """make_single with its graph in int8, too."""
    make_single(folder, size)
    data = make_graph(["radiance", "exposure"], size * size, seed=size, int8=True).SerializeToString()
    (folder / "color.int8.onnx").write_bytes(data)
    manifest = json.loads((folder / "manifest.json").read_text())
    graph = {"file": "color.int8.onnx", "sha256": hashlib.sha256(data).hexdigest()}
    manifest["variants"] = {"int8": {"rell2_over_fp32": 1.005, "graphs": {"color": graph}}}
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=2))


def make_hostile(folder: Path) -> None:
    """Graphs that must be refused before an engine sees them."""
    folder.mkdir(parents=True, exist_ok=True)

    def save(name: str, nodes: list[onnx.NodeProto], **extra: object) -> onnx.ModelProto:
        ports = [helper.make_tensor_value_info(port, TensorProto.FLOAT, [1]) for port in ("radiance", "logits")]
        graph = helper.make_graph(nodes, "network", ports[:1], ports[1:], **extra)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18), helper.make_opsetid("evil", 1)])
        (folder / name).write_bytes(model.SerializeToString())
        return model

    plain = helper.make_node("Identity", ["radiance"], ["logits"])
    save("plain.onnx", [plain])
    save("domain.onnx", [helper.make_node("Identity", ["radiance"], ["logits"], domain="evil")])
    save("operator.onnx", [helper.make_node("RandomNormalLike", ["radiance"], ["logits"])])
    branch = helper.make_graph([], "branch", [], [])
    save("subgraph.onnx", [helper.make_node("If", ["radiance"], ["logits"], then_branch=branch, else_branch=branch)])
    save("hidden.onnx", [helper.make_node("Identity", ["radiance"], ["logits"], extra=branch)])
    weight = numpy_helper.from_array(np.zeros(1, np.float32), "weight")
    weight.ClearField("raw_data")
    weight.data_location = TensorProto.EXTERNAL
    entry = weight.external_data.add()
    entry.key, entry.value = "location", "/etc/passwd"
    save("external.onnx", [plain], initializer=[weight])
    constant = helper.make_node("Constant", [], ["logits"], value=weight)
    save("external-constant.onnx", [constant])
    model = save("functions.onnx", [plain])
    model.functions.append(helper.make_function("evil", "F", ["a"], ["b"], [helper.make_node("Abs", ["a"], ["b"])], []))
    (folder / "functions.onnx").write_bytes(model.SerializeToString())


def main(root: Path) -> None:
    make_hostile(root / "hostile")
    make_single(root / "single-3", 3)
    make_single(root / "single-21", 21)
    make_single(root / "trust-5", 5, spread=3.0, trust=True)
    make_single(root / "steep-5", 5, spread=1e5)
    make_single(root / "broken-3", 3, spread=np.inf)  # all logits are NaN
    make_greedy(root / "greedy-3")
    make_pyramid(root / "pyramid")
    make_quantised(root / "quantised-3", 3)
    make_split(root / "split-5", 5, samples=False)
    make_split(root / "samples-5", 5, samples=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
