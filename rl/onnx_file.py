"""A policy as an ONNX file, and beside it what its numbers mean."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto, helper, numpy_helper

from jaxsim.components import dump
from jaxsim.errors import InputError
from jaxsim.laws.policy import Network, Policy
from jaxsim.provenance import provenance, write_json

_OPSET = 17
_AGREES = 1e-5  # largest difference of an action, both in float32
_SAMPLES = 256
_ACTIVATIONS = {"tanh": "Tanh", "relu": "Relu"}


def export(policy: Policy, path: Path) -> float:
    """Write PATH.onnx and PATH.json; the largest difference to the policy's own actions.

    Input `observation` (batch, channels) and output `action` (batch, actions), float32; the
    normalisation is in the graph. The sidecar names the channels with unit, full scale and
    bounds, the actions with unit, centre and full scale, sensors and rate.

    Raises: InputError where onnxruntime's actions differ from the policy's by more than 1e-5.
    """
    network = policy.network
    model = helper.make_model(
        _graph(network), opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=8
    )
    onnx.checker.check_model(model)
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(model, path)
    write_json(path.with_suffix(".json"), sidecar(policy))
    difference = check(path, network)
    if not difference <= _AGREES:
        rule = f"must give the policy's actions to {_AGREES:g}"
        raise InputError(str(path), rule, f"a difference of {difference:.3g}", "report this")
    return difference


def check(path: Path, network: Network) -> float:
    """The largest difference between onnxruntime's and the network's own actions."""
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    random = np.random.default_rng(0)
    shape = _SAMPLES, network.sizes[0]
    seen = np.asarray(network.mean) + np.asarray(network.scale) * random.normal(0.0, 2.0, shape)
    seen = seen.astype(np.float32)
    (got,) = session.run(["action"], {"observation": seen})
    want = np.stack([np.asarray(network(row)) for row in seen])
    return float(np.abs(np.asarray(got) - want).max())


def _graph(network: Network) -> Any:
    """Sub, Div, Clip, then Gemm and activation per layer."""
    constants = {"mean": network.mean, "scale": network.scale}
    constants |= {"low": -network.bound, "high": network.bound, "one": 1.0, "minus_one": -1.0}
    nodes = [
        helper.make_node("Sub", ["observation", "mean"], ["centred"]),
        helper.make_node("Div", ["centred", "scale"], ["scaled"]),
        helper.make_node("Clip", ["scaled", "low", "high"], ["z0"]),
    ]
    last = len(network.layers) - 1
    for i, layer in enumerate(network.layers):
        constants |= {f"weight{i}": layer.weight, f"bias{i}": layer.bias}
        own = [f"z{i}", f"weight{i}", f"bias{i}"]
        nodes.append(helper.make_node("Gemm", own, [f"sum{i}"], transB=1))
        out = "action" if i == last else f"z{i + 1}"
        nodes.append(_activation(network.squash if i == last else network.activation, i, out))
    tensors = [
        numpy_helper.from_array(np.asarray(value, np.float32), name)
        for name, value in constants.items()
        if any(name in node.input for node in nodes)  # onnxruntime warns of the others
    ]
    takes, *_, gives = network.sizes
    ends = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", size])
        for name, size in (("observation", takes), ("action", gives))
    ]
    return helper.make_graph(nodes, "policy", ends[:1], ends[1:], tensors)


def _activation(kind: str, layer: int, out: str) -> Any:
    if kind == "clip":
        return helper.make_node("Clip", [f"sum{layer}", "minus_one", "one"], [out])
    return helper.make_node(_ACTIVATIONS[kind], [f"sum{layer}"], [out])


def sidecar(policy: Policy) -> dict[str, Any]:
    """What the numbers mean: names, units, scaling, rate."""
    return {
        "observation": [
            {"name": c.name, "unit": c.unit, "full_scale": c.full_scale, "low": c.low}
            | {"high": c.high}
            for c in policy.channels
        ],
        "observation_is": "value/full_scale, clipped to [low, high]",
        "action": [
            {"name": a.name, "unit": a.unit, "full_scale": a.full_scale, "centre": a.centre}
            | {"parameter": a.parameter}
            for a in policy.actions
        ],
        "action_is": "centre + full_scale*action is the parameter, held for a period",
        "period_s": policy.period,
        "duration_s": policy.duration,
        "sensors": dump(policy.sensors),
        "law_at_work": dump(policy.base),
        **provenance(dtype="float32"),
    }


__all__ = ["check", "export", "sidecar"]
