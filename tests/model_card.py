"""What the model card of a family of weights says of its files, from the files themselves."""

import hashlib
from typing import Any

from swarmchase.controllers.shipped import shipped_families
from swarmchase.networks.weights import checked_weights, read_weights


def files_table(family: str) -> str:
    """The table of its card."""
    head = "| file | F (Hz) | rho | form | objective | actions | update | parameters | SHA-256 begins |"
    return "\n".join([head, f"|{'---|' * 9}", *(_row(weights.path) for weights in shipped_families()[family])])


def _row(path: Any) -> str:
    form, tensors, document = checked_weights(path)
    scenarios = document.get("scenarios", [])
    losses = document["settings"].get("losses", {})
    cells = [
        f"[{path.name}]({path.name})",
        _values(scenarios, "sampling_hz"),
        _values(scenarios, "spatial_correlation"),
        form.name,
        losses.get("objective", "-"),
        document.get("action_choice", "-"),
        f"{document['update']:,}",
        f"{sum(tensor.numel() for tensor in tensors.values()):,}",
        f"`{hashlib.sha256(read_weights(path)).hexdigest()[:12]}`",
    ]
    return f"| {' | '.join(cells)} |"


def _values(scenarios: list[dict[str, Any]], name: str) -> str:
    return ", ".join(f"{value:g}" for value in sorted({one[name] for one in scenarios})) or "-"
