"""Makes the model of rendered clips that comes with srflow, in crates/mer/models/rendered.

    python tools/rendered_model.py SRFLOW FOLDER

SRFLOW is the binary; FOLDER is for the clips. Two cores take about half an hour.
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path

# Intensity of the expressions, and the seed of their heads and motion.
SETS = {"0.4": "104", "1": "11", "2.5": "125"}
NOTE = "This model learned from rendered faces alone: draw no conclusions about people."
MODEL = Path(__file__).parent.parent / "crates/mer/models/rendered"


def main(srflow, folder):
    folder = Path(folder)
    for intensity, seed in SETS.items():
        size = ["--subjects", "24", "--clips", "12", "--side", "192", "--fps", "60", "--only-key-frames"]
        command = [srflow, "mer", "synth", "--out", folder / intensity, *size, "--intensity", intensity, "--seed", seed]
        subprocess.run(command, check=True)
    data = [f"clips:{folder / intensity}" for intensity in SETS]
    command = [srflow, "mer", "run", "--only-key-frames", "--data", *data, "--sets", "composite"]
    subprocess.run([*command, "--save-model", folder / "model", "--out", folder / "results"], check=True)
    card = json.loads((folder / "model/model.json").read_text())
    card["note"] = NOTE
    for data, intensity in zip(card["data"], SETS, strict=True):
        data["dataset"] = f"rendered, intensity {intensity}"
    MODEL.mkdir(parents=True, exist_ok=True)
    (MODEL / "model.json").write_text(json.dumps(card, indent=2) + "\n")
    for name in ["classifier.safetensors", "patterns.safetensors"]:
        shutil.copy(folder / "model" / name, MODEL)


if __name__ == "__main__":
    main(*sys.argv[1:])
