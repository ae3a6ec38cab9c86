"""``swarmchase export``: a learned controller's networks as an ONNX file."""

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from .. import __version__
from ..files import require_writable_file
from .options import DEFAULT_CONTROLLER, ControllerName, ScenarioOptions, explain_choice
from .terminal import CONSOLE, print_json


@dataclass(frozen=True, kw_only=True)
class ExportCommand(ScenarioOptions):
    """Write a learned controller's networks as an ONNX file, for a computer with onnxruntime and no torch. It takes
    levels in dBm, NaN where a sample is missing; docs/onnx.md says what each file gives."""

    file: Positional[Path]
    """To write."""
    controller: ControllerName = DEFAULT_CONTROLLER
    overwrite: bool = False
    """Replace the file if it is there already."""
    json: bool = False
    """Print what the file says of itself as one JSON object on standard output."""

    def run(self) -> None:
        """Write it."""
        from ..controllers import learned_networks, require_controller, weights_sha256
        from ..networks.onnx_file import save_onnx

        require_writable_file(self.file, replaces=self.overwrite)
        scenario = self.world()
        require_controller(self.controller, scenario)
        networks, action_choice = learned_networks(self.controller, scenario)
        explain_choice(self.controller, scenario)
        told = save_onnx(
            self.file,
            networks,
            scenario,
            {
                "version": __version__,
                "controller": self.controller,
                "weights_sha256": weights_sha256(self.controller, scenario),
                "form": networks.form,
                "action_choice": action_choice,
                "scenario": scenario.to_dict(),
            },
        )
        shapes = f"{', '.join(told['inputs'])} in, {', '.join(told['outputs'])} out"
        CONSOLE.print(f"{self.file}: {shapes}", markup=False, soft_wrap=True)
        if self.json:
            print_json({"file": str(self.file), **told})
