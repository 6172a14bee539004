"""Every job of the command `srflow` as a function; its settings are keywords.

`callback` is called with progress: a dict with `done` and `total`, and what the job adds, such as `bytes` or `loss`. When it raises an
exception, or on Ctrl-C, the job stops in order and the exception is raised; the same call continues. Each function returns a
`Report`: a dict as the command prints with `--json`, whose keys are attributes too.

Written from the settings of the jobs by a test, crates/cli/tests/srflow/python_jobs.rs.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, Callable, Sequence

from . import _srflow
from ._report import Report

if TYPE_CHECKING:
    Path = str | os.PathLike[str]
    Callback = Callable[[dict[str, Any]], object]


def _run(job: str, settings: dict[str, Any]) -> Report:
    callback = settings.pop("callback")
    return Report(*_srflow.run_job(job, settings, callback))


def _listed(values: Any) -> Any:
    one = isinstance(values, str | os.PathLike | int | float)
    return [values] if one else None if values is None else list(values)


def demo(
    out: Path = "srflow-demo",
    *,
    head: str = "builtin",
    seed: int = 5,
    size: str = "2200x3208",
    kitti: Path | None = None,
    pair: Path | Sequence[Path] | None = None,
    open: bool = False,
    force: bool = False,
    callback: Callback | None = None,
) -> Report:
    """Render a small dataset, estimate its flow, score it and show everything in one report.

    Args:
        out: Folder for the datasets, the scores and report.html.
        head: Head model: `builtin` (a head sculpted by code from a seed), `ict:DIR` (ICT-FaceKit's FaceXModel folder), `builtin-average` (the average built-in head, whose identity basis are the traits of persons), `flame:FILE` (FLAME 2020 or 2023 (.pkl or .npz) with VHAP's teeth), `flame-toothless:FILE` (FLAME as published), `gnm:FILE` (GNM Head 3 (gnm_head.npz)), `gltf:FILE` (any head as .glb or .gltf), `obj:FILE` (any mesh as Wavefront .obj, such as a scan), `lam:DIR|ZIP` (an avatar of LAM: skin.glb and offset.ply), `avatar:DIR` (a trained avatar: point_cloud.ply and flame_param.npz; DIR@HEAD where no head.json names its head model).
        seed: Random seed; each seed renders other heads.
        size: Size of the large frames, WIDTHxHEIGHT; smaller is faster.
        kitti: Folder of KITTI 2015, to also score photographs with true flow.
        pair: Two photographs and the true flow between them.
        open: Open the report in the browser.
        force: Delete an existing demo and regenerate everything.
        callback: Called with progress.
    """
    settings = locals()
    for name in ("pair",):
        settings[name] = _listed(settings[name])
    return _run("demo", settings)


def render(
    out: Path,
    *,
    preset: str | None = None,
    shard: str = "1/1",
    stop_after: int | None = None,
    force: bool = False,
    head: str = "builtin",
    look: int = 2,
    scenes: int = 27,
    frames: float = 413.37,
    size: str = "2200x3208",
    splits: str = "0.61,0.11,0.28",
    seed: int = 1,
    flow_format: str = "npz16",
    backward: bool = False,
    decompose: bool = False,
    shading_change: bool = False,
    depth: bool = False,
    regions: bool = False,
    background: str = "#ffffff",
    motion: str = "curves",
    device: str = "cpu",
    noise: float = 0,
    lighting: float = 0,
    lamps: float = 0,
    shutter: float = 0,
    defocus: float = 0,
    jpeg: int | None = None,
    callback: Callback | None = None,
) -> Report:
    """Render a facial optical-flow dataset with exact flow from a head avatar.

    Args:
        out: Folder of the dataset.
        preset: Defaults of other settings: `wild` combines a procedural background, mixed motion and every effect of a recording.
        shard: Process only part I of N; `auto` reads I and N from the variables of Slurm and other job engines, `auto/N` only I, as for Kubernetes and PBS.
        stop_after: Stop after N pairs, clips or timesteps; the same command continues.
        force: Delete the dataset in the folder and start over.
        head: Head model: `builtin` (a head sculpted by code from a seed), `ict:DIR` (ICT-FaceKit's FaceXModel folder), `builtin-average` (the average built-in head, whose identity basis are the traits of persons), `flame:FILE` (FLAME 2020 or 2023 (.pkl or .npz) with VHAP's teeth), `flame-toothless:FILE` (FLAME as published), `gnm:FILE` (GNM Head 3 (gnm_head.npz)), `gltf:FILE` (any head as .glb or .gltf), `obj:FILE` (any mesh as Wavefront .obj, such as a scan), `lam:DIR|ZIP` (an avatar of LAM: skin.glb and offset.ply), `avatar:DIR` (a trained avatar: point_cloud.ply and flame_param.npz; DIR@HEAD where no head.json names its head model).
        look: Version of how heads look; 1 keeps the bytes of earlier datasets.
        scenes: Number of scenes, one subject each.
        frames: Frame pairs per scene; a fraction is the mean over scenes of nearly equal length.
        size: Size of the frames, WIDTHxHEIGHT.
        splits: Shares of train, val and test scenes, which sum to 1.
        seed: Random seed.
        flow_format: File format of the flow: flo, png, png128, pfm, flo5, npy, npz, npz16.
        backward: Also write the flow from frame 2 to frame 1.
        decompose: Also write the flow with the head moving alone, and what the expression adds to it.
        shading_change: Also write how much brighter or darker each surface becomes: the part of the change that is no motion.
        depth: Also write depth.
        regions: Also write region maps: skin, eyes, mouth, hair or neck for each pixel.
        background: Background: white, black, #rrggbb, `procedural` (rooms, textures, gradients, lights), or a folder of images.
        motion: Motion: `curves` (random expressions, speech, blinks, gaze and turns), `mixed` (also micro-expressions, at many speeds), `own` (the avatar's training motion), or the flame_param.npz, capture or clip (FILE.glb@CLIP) of another subject with the same kind of head.
        device: Device to rasterize on.
        noise: Sensor noise, 0 to 50; at 1 a standard deviation of 0.9 levels of 255 in black, 1.8 in mid-grey and 2.3 in white.
        lighting: Exposure and white balance, 0 to 4; at 1 off by up to half a stop, with changes of 2 % within a scene.
        lamps: Share of the head's light from one to three lamps, 0 to 1.
        shutter: Motion blur: share of the time between frames during which the shutter is open, 0 to 1, centred at the frame's time.
        defocus: Blur radius of a lens out of focus, 0 to 64 pixels.
        jpeg: Minimum JPEG quality, 1 to 100; each scene draws one from here to 95, or uses this one if it is higher.
        callback: Called with progress.
    """
    settings = locals()
    return _run("render", settings)


def shapes(
    out: Path,
    *,
    pairs: int = 22872,
    size: str = "512x384",
    motion: str = "0.25,32",
    textures: Path | None = None,
    seed: int = 1,
    flow_format: str = "npz16",
    shard: str = "1/1",
    stop_after: int | None = None,
    force: bool = False,
    callback: Callback | None = None,
) -> Report:
    """Render a dataset of generic pairs with exact flow and occlusion, to start training from.

    Args:
        out: Folder of the dataset.
        pairs: Number of pairs.
        size: Size of the frames, WIDTHxHEIGHT.
        motion: Typical motion in pixels, from the shortest to the longest; each octave is equally likely.
        textures: Folder of images for half of the layers [default: procedural textures].
        seed: Random seed.
        flow_format: File format of the flow: flo, png, png128, pfm, flo5, npy, npz, npz16.
        shard: Process only part I of N; `auto` reads I and N from the variables of Slurm and other job engines, `auto/N` only I, as for Kubernetes and PBS.
        stop_after: Stop after N pairs, clips or timesteps; the same command continues.
        force: Delete the dataset in the folder and start over.
        callback: Called with progress.
    """
    settings = locals()
    return _run("shapes", settings)


def flow(
    frames: Path | Sequence[Path],
    out: Path,
    *,
    method: str = "srflow",
    format: str = "flo",
    viz: Path | None = None,
    uncertainty: Path | None = None,
    occlusion: Path | None = None,
    viz_max: float | None = None,
    initial_flow: Path | None = None,
    warm_start: bool = False,
    batch: int = 1,
    force: bool = False,
    save_crops: Path | None = None,
    shard: str = "1/1",
    face: str | None = None,
    face_index: int | None = None,
    face_models: Path | None = None,
    face_box: str | None = None,
    landmarks: Path | None = None,
    refine: bool = False,
    start: str | None = None,
    weights: str | None = None,
    iters: str | None = None,
    set: dict[str, Any] | None = None,
    precision: str = "f32",
    device: str = "cpu",
    tile: str | None = None,
    tile_overlap: int = 128,
    scale: float | None = None,
    pyr_scale: float | None = None,
    levels: int | None = None,
    winsize: int | None = None,
    iterations: int | None = None,
    poly_n: int | None = None,
    poly_sigma: float | None = None,
    farneback_gaussian: bool = False,
    tau: float | None = None,
    lambda_: float | None = None,
    theta: float | None = None,
    nscales: int | None = None,
    warps: int | None = None,
    epsilon: float | None = None,
    inner_iterations: int | None = None,
    outer_iterations: int | None = None,
    scale_step: float | None = None,
    gamma: float | None = None,
    median_filtering: int | None = None,
    callback: Callback | None = None,
) -> Report:
    """Estimate optical flow between frames.

    Args:
        frames: Two frames or more, a folder of them, or a video; or several folders or videos.
        out: Flow file, or folder of flow files.
        method: How to estimate the flow: farneback, tvl1, srflow, raft, raft-small, gma, skflow, rpknet, dpflow, ccmr, ccmr-p, sea-raft-s, sea-raft-m, sea-raft-l, memflow, flownets, flownetc, flownetcss, flownet3-css, unimatch, unimatch-sc2, unimatch-sc2-ref6, ssa; a network followed by its weights, as in raft=FILE; srflow has its own.
        format: Format of the files in a folder.
        viz: Also draw the flow in colours: into a PNG file, a folder of PNG files, or a video.
        uncertainty: Also write the expected error of each component of the flow in pixels, as .npy of shape (H, W), a file or a folder like --out; with --viz also as PNG next to it; for srflow, dpflow, sea-raft-s, sea-raft-m, sea-raft-l.
        occlusion: Also write the probability that a pixel of the first frame is hidden in the second, as .npy of shape (H, W), a file or a folder like --out; with --viz also as PNG next to it; for flownet3-css.
        viz_max: Flow length in pixels of full colour, and the uncertainty drawn brightest [default: the largest of each pair].
        initial_flow: Start from this flow (for two frames).
        warm_start: Start each pair of a sequence from the flow of the previous one, projected forward.
        batch: Pairs of a sequence to estimate at once with a network.
        force: Overwrite existing files.
        save_crops: With --face, --face-box or --landmarks: also write the cropped frames as PNG files; the flow is that of these frames.
        shard: Process only part I of N; `auto` reads I and N from the variables of Slurm and other job engines, `auto/N` only I, as for Kubernetes and PBS.
        face: Find the face with MediaPipe's networks, and write its landmarks next to the results; pass that file to `--landmarks` to repeat the run without the networks.
        face_index: Face to use if there are several; 1 is the leftmost.
        face_models: MediaPipe's networks: face_landmarker.task, its package as a folder or .whl file, or a folder with face_detection_short_range.tflite and face_landmark.tflite [default: $SRFLOW_FACE_MODELS, or the package that python3 has installed].
        face_box: Crop every frame to this box: LEFT,TOP,WIDTHxHEIGHT in pixels.
        landmarks: Align faces by the landmarks in this CSV file (dlib's 68 points or the eyes; see docs/guides/faces.md).
        refine: Refine the flow of every method with TV-L1 at full size; one scale and one warp, unless --nscales and --warps are set; the other parameters of tvl1 apply too.
        start: Start networks from the flow of this method, such as tvl1 or raft-small=FILE, in place of their own start.
        weights: Weights of the network: a file (PyTorch, Lightning, safetensors), or the name of published weights, such as things; `srflow models` lists them.
        iters: Refinement iterations; auto does the network's own number at most, and stops once the flow moves less than 0.07 px, auto:PX less than PX [default: the network's own, see `srflow models`].
        set: Network setting that the weights do not store; `srflow models` lists them.
        precision: Numbers that networks multiply: `f16` and `bf16` are less exact, but faster on GPUs with matrix units for them; `bf16` is up to twice as fast on CPUs with AVX512-BF16; `auto` uses them only there. Sums, softmax, norms and flow are always f32.
        device: Device to compute on; this build has cpu.
        tile: Estimate tile by tile and blend the overlaps; `auto` uses the largest tiles that fit into free memory, or none if the whole frame fits.
        tile_overlap: Overlap of neighbouring tiles in pixels, up to half a tile.
        scale: Resize the frames by this factor before estimation, and the flow back to full size.
        pyr_scale: Size of a pyramid level relative to the next finer one [default: 0.5].
        levels: Pyramid levels in addition to the full size [default: 5].
        winsize: Side of the averaging window in pixels [default: 13].
        iterations: Iterations at each level [default: 10].
        poly_n: Radius of the polynomial fit in pixels [default: 5].
        poly_sigma: Standard deviation of the fit's weight in pixels [default: 1.1].
        farneback_gaussian: Use a Gaussian averaging window in place of a box.
        tau: Time step of the dual update [default: 0.25].
        lambda_: Weight of the data term; smaller is smoother [default: 0.15].
        theta: Tightness of the coupling of data term and smoothness [default: 0.3].
        nscales: Number of scales [default: 5].
        warps: Warps at each scale [default: 5].
        epsilon: Stop iterating when the flow changes by less than this, in pixels [default: 0.01].
        inner_iterations: Iterations between two median filters [default: 30].
        outer_iterations: Median filters after each warp [default: 10].
        scale_step: Size of a scale relative to the next finer one [default: 0.8].
        gamma: Weight of an additional brightness change; 0 disables it [default: 0].
        median_filtering: Side of the median filter, 3 or 5 pixels, or 1 for none [default: 5].
        callback: Called with progress.
    """
    settings = locals()
    for name in ("frames",):
        settings[name] = _listed(settings[name])
    settings["lambda"] = settings.pop("lambda_")
    return _run("flow", settings)


def face(
    frames: Path | Sequence[Path],
    out: Path,
    *,
    points: str = "dlib",
    blendshapes: bool = False,
    viz: Path | None = None,
    face_index: int | None = None,
    fps: float | None = None,
    force: bool = False,
    face_models: Path | None = None,
    callback: Callback | None = None,
) -> Report:
    """Write the landmarks of a face in each frame.

    Args:
        frames: A video, a folder of frames, or frames.
        out: CSV file to write.
        points: Points: dlib (68) or mesh (MediaPipe's 468; 478 with the irises from face_landmarker.task).
        blendshapes: Also write MediaPipe's 52 blend shapes; needs face_landmarker.task.
        viz: Draw the points into frames: a video, or a folder of PNGs.
        face_index: Face to follow if there are several; 1 is the leftmost.
        fps: Frames per second [default: those of the video; without any, there are no timestamps].
        force: Overwrite existing files.
        face_models: MediaPipe's networks: face_landmarker.task, its package as a folder or .whl file, or a folder with face_detection_short_range.tflite and face_landmark.tflite [default: $SRFLOW_FACE_MODELS, or the package that python3 has installed].
        callback: Called with progress.
    """
    settings = locals()
    for name in ("frames",):
        settings[name] = _listed(settings[name])
    return _run("face", settings)


def metrics(
    prediction: Path,
    *,
    truth: Path | None = None,
    mask: Path | None = None,
    regularizers: bool = False,
    image: Path | None = None,
    image_max: float = 255,
    m_total: str = "interior",
    callback: Callback | None = None,
) -> Report:
    """Score one flow against the ground truth, or evaluate the paper's regularizers on it.

    Args:
        prediction: Predicted flow (.flo, KITTI .png, .pfm, .flo5, .npy, .npz).
        truth: Ground truth, in any of these formats.
        mask: Mask: score only pixels above 127, or of 1 in a mask of 0 and 1; for the regularizers, the head.
        regularizers: Evaluate the four regularizers on PRED.
        image: First frame of PRED.
        image_max: Value of a white pixel of FRAME1 for the gradients of MIGAR and IGVAR.
        m_total: Pixels of the head that MIGAR and IGVAR use: all but the outline, or the paper's formula as printed.
        callback: Called with progress.
    """
    settings = locals()
    return _run("metrics", settings)


def convert(
    input: Path,
    output: Path,
    *,
    viz: bool = False,
    max: float | None = None,
    channels_first: bool = False,
    ply_up: str = "y",
    force: bool = False,
    callback: Callback | None = None,
) -> Report:
    """Convert a flow or 3D Gaussians between file formats, or draw a flow in colours.

    Args:
        input: Flow or Gaussians to read.
        output: File to write.
        viz: Draw the flow in the colours of Middlebury's wheel, as a .png; unknown pixels are black.
        max: Length of the flow with full colour, in pixels (default: the longest of the picture).
        channels_first: IN is a .npy of shape (2, H, W), as tensors of PyTorch are, not (H, W, 2).
        ply_up: Up direction of a .ply of Gaussians, which does not store it: y, as for srflow's heads, or -y, as for most scenes from photographs.
        force: Overwrite OUT.
        callback: Called with progress.
    """
    settings = locals()
    return _run("convert", settings)


def rasterize(
    out: Path,
    *,
    gaussians: Path | None = None,
    next: Path | None = None,
    head: str | None = None,
    motion: str | None = None,
    timestep: int | None = None,
    action_units: str | None = None,
    seed: int = 1,
    timestep_next: int | None = None,
    action_units_next: str | None = None,
    camera: Path | None = None,
    view: str | None = None,
    camera_next: Path | None = None,
    view_next: str | None = None,
    size: str | None = None,
    orbit: str | None = None,
    path: Path | None = None,
    fps: int = 25,
    background: str = "#000000",
    pixel_convention: str = "splat",
    antialiased: bool = False,
    sort_per_pixel: bool = False,
    force: bool = False,
    callback: Callback | None = None,
) -> Report:
    """Rasterize a file of 3D Gaussians or a head: colour, flow, alpha and depth.

    Args:
        out: Folder to write into, created if missing; with a moving camera also a video file.
        gaussians: Gaussians of this frame: .ply, .splat, .spz, .glb, .ksplat or .sog.
        next: Gaussians of the next frame: the same ones in the same order.
        head: Head, instead of a file of Gaussians: `builtin` (a head sculpted by code from a seed), `ict:DIR` (ICT-FaceKit's FaceXModel folder), `builtin-average` (the average built-in head, whose identity basis are the traits of persons), `flame:FILE` (FLAME 2020 or 2023 (.pkl or .npz) with VHAP's teeth), `flame-toothless:FILE` (FLAME as published), `gnm:FILE` (GNM Head 3 (gnm_head.npz)), `gltf:FILE` (any head as .glb or .gltf), `obj:FILE` (any mesh as Wavefront .obj, such as a scan), `lam:DIR|ZIP` (an avatar of LAM: skin.glb and offset.ply), `avatar:DIR` (a trained avatar: point_cloud.ply and flame_param.npz; DIR@HEAD where no head.json names its head model).
        motion: Motion of the head: `own` (the avatar's training motion), the flame_param.npz, capture or clip (FILE.glb@CLIP) of another subject with the same kind of head, or `curves` (10 s of random motion at 24 frames per second) [default: own if it has one, else curves].
        timestep: Timestep of the motion in this frame, from 0.
        action_units: Action units in place of a motion, 0 to 1 each, such as 6=0.5,12_L=1.
        seed: Seed of the person and of the random motion, for built-in heads.
        timestep_next: Timestep of the motion in the next frame.
        action_units_next: Action units in the next frame.
        camera: Camera of this frame [default: one that sees all Gaussians from +z, where +y is up; those of a .splat file from -z, where -y is up].
        view: Camera of CAM: its picture's name, with or without folder and extension, or its number from 0.
        camera_next: Camera of the next frame, of the same image size.
        view_next: Camera to use from --camera-next, or from --camera without --camera-next.
        size: Size of the pictures, with the camera's aspect ratio; required if CAM has no size.
        orbit: Move the camera around the centre of the Gaussians; positive DEGREES move it to the right [default: a frame every 3 degrees].
        path: Move through the cameras of this file, in their order.
        fps: Frames per second of the video.
        background: Background colour: white, black, #rrggbb or R,G,B (0 to 255 each).
        pixel_convention: Convention for pixel coordinates of the flow.
        antialiased: Reduce the opacity of Gaussians smaller than a pixel, for Gaussians trained with antialiasing [default: as their file says].
        sort_per_pixel: Sort the Gaussians along the ray of each pixel, to avoid popping when the camera moves.
        force: Overwrite existing files in OUT.
        callback: Called with progress.
    """
    settings = locals()
    return _run("rasterize", settings)


def models(
    *,
    callback: Callback | None = None,
) -> Report:
    """List the networks.

    Args:
        callback: Called with progress.
    """
    settings = locals()
    return _run("models", settings)


def models_inspect(
    file: Path,
    *,
    callback: Callback | None = None,
) -> Report:
    """Inspect a file of weights.

    Args:
        file: Weights: PyTorch (.pth, .pt, .ckpt), safetensors, burnpack, TensorFlow (.index), Keras (.h5) or an index of several files (.index.json).
        callback: Called with progress.
    """
    settings = locals()
    return _run("models inspect", settings)


def models_export(
    weights: str,
    out: Path,
    *,
    half: bool = False,
    iters: int | None = None,
    size: str | None = None,
    force: bool = False,
    callback: Callback | None = None,
) -> Report:
    """Export weights for PyTorch or as safetensors, or a network as ONNX.

    Args:
        weights: Weights: a file, the name of published weights, such as skflow-things, or the name of a built-in network.
        out: File to write: .ckpt, .pt or .pth (PyTorch), .safetensors, or .onnx.
        half: Store 16-bit numbers, in half the bytes; for .safetensors.
        iters: Refinement iterations, fixed in the file; for .onnx [default: the network's own, see `srflow models`].
        size: Accept only frames of this size, WIDTHxHEIGHT; for .onnx [default: it takes any size].
        force: Overwrite an existing file.
        callback: Called with progress.
    """
    settings = locals()
    return _run("models export", settings)


def device(
    *,
    callback: Callback | None = None,
) -> Report:
    """List the devices of this machine.

    Args:
        callback: Called with progress.
    """
    settings = locals()
    return _run("device", settings)


def device_network(
    network: str,
    *,
    iters: str | None = None,
    weights: Path | None = None,
    precision: str = "f32",
    device: str = "cpu",
    size: str = "800x512",
    repeats: int = 4,
    against_cpu: bool = False,
    callback: Callback | None = None,
) -> Report:
    """Time a network on two frames of the built-in head.

    Args:
        network: Name of the network; `srflow models` lists them.
        iters: Refinement iterations [default: the network's own].
        weights: File of weights.
        precision: Numbers that the network multiplies on the device; with --against-cpu, the CPU uses f32.
        device: Device to compute on; this build has cpu.
        size: Size of the frames, WIDTHxHEIGHT.
        repeats: Number of runs; the first includes the compilation of kernels.
        against_cpu: Also compute on the CPU, and print the differences.
        callback: Called with progress.
    """
    settings = locals()
    return _run("device network", settings)


def device_rasterizer(
    *,
    device: str = "cpu",
    size: str = "800x512",
    repeats: int = 4,
    against_cpu: bool = False,
    callback: Callback | None = None,
) -> Report:
    """Time the rasterizer: frame, flow, alpha and depths of the built-in head.

    Args:
        device: Device to compute on; this build has cpu.
        size: Size of the frames, WIDTHxHEIGHT.
        repeats: Number of runs; the first includes the compilation of kernels.
        against_cpu: Also compute on the CPU, and print the differences.
        callback: Called with progress.
    """
    settings = locals()
    return _run("device rasterizer", settings)


def train(
    config: Path | None = None,
    out: Path | None = None,
    *,
    resume: Path | None = None,
    print_config: bool = False,
    stop_after_step: int | None = None,
    device: str | Sequence[str] | None = None,
    mpi: bool = False,
    data: str | Sequence[str] | None = None,
    validation: str | Sequence[str] | None = None,
    network: str | None = None,
    weights: str | None = None,
    steps: int | None = None,
    epochs: int | None = None,
    batch: int | None = None,
    crop: str | None = None,
    iterations: int | None = None,
    learning_rate: float | None = None,
    seed: int | None = None,
    set: dict[str, Any] | None = None,
    callback: Callback | None = None,
) -> Report:
    """Train an optical flow network.

    Args:
        config: Preset (skflow, rpknet, memflow, dpflow, srflownet-tvr, srflownet-fdr, srflownet-migar, srflownet-igvar, sea-raft, ssa, srflow, finetune, cpu-small, cpu-srflownet) or TOML file [default: skflow].
        out: Folder of the run.
        resume: Continue the run in this folder from its last checkpoint.
        print_config: Print the configuration with every key instead of training, as TOML or JSON.
        stop_after_step: Write a checkpoint and stop after this step; `resume` continues.
        device: Device to train on; several devices share each batch.
        mpi: Share every batch with the other processes of `mpirun` or `srun`.
        data: Training dataset, KIND:DIR or KIND:DIR*TIMES; several are mixed; `shapes:` and `rendered:` generate pairs during training.
        validation: Validation dataset [default: the val split of the training data].
        network: Network.
        weights: Initial weights: a file, or the name of published weights, such as things.
        steps: Number of steps; overrides the epochs.
        epochs: Epochs.
        batch: Batch size in pairs.
        crop: Crop size.
        iterations: Refinement iterations of the network.
        learning_rate: Peak learning rate.
        seed: Random seed.
        set: Any key of the configuration, e.g. training.clip=0.5 or loss.fdr=0.05.
        callback: Called with progress.
    """
    settings = locals()
    for name in ("device", "data", "validation"):
        settings[name] = _listed(settings[name])
    return _run("train", settings)


def ablation(
    out: Path,
    config: Path | None = None,
    *,
    rows: str | Sequence[str] | None = None,
    seeds: int | Sequence[int] | None = None,
    control: str | Sequence[str] | None = None,
    test: str | Sequence[str] | None = None,
    device: str | Sequence[str] | None = None,
    data: str | Sequence[str] | None = None,
    validation: str | Sequence[str] | None = None,
    network: str | None = None,
    weights: str | None = None,
    steps: int | None = None,
    epochs: int | None = None,
    batch: int | None = None,
    crop: str | None = None,
    iterations: int | None = None,
    learning_rate: float | None = None,
    seed: int | None = None,
    set: dict[str, Any] | None = None,
    callback: Callback | None = None,
) -> Report:
    """Train with each loss of the paper and print its Table V.

    Args:
        out: Folder for the runs and the table.
        config: Preset or TOML file shared by all runs, except for its loss weights and seed [default: skflow].
        rows: Rows to run: start, control, none, tvr, fdr, migar, igvar, migar-literal, igvar-literal [default: all; start, which is not trained, only with --weights, control only with --control].
        seeds: Seeds for every row.
        control: Training data of the row `control`, KIND:DIR; several for a mix.
        test: Dataset to score on, KIND:DIR@SPLIT; several for tables of each [default: the test split of the first training dataset].
        device: Device to train on; several devices share each batch.
        data: Training dataset, KIND:DIR or KIND:DIR*TIMES; several are mixed; `shapes:` and `rendered:` generate pairs during training.
        validation: Validation dataset [default: the val split of the training data].
        network: Network.
        weights: Initial weights: a file, or the name of published weights, such as things.
        steps: Number of steps; overrides the epochs.
        epochs: Epochs.
        batch: Batch size in pairs.
        crop: Crop size.
        iterations: Refinement iterations of the network.
        learning_rate: Peak learning rate.
        seed: Random seed.
        set: Any key of the configuration, e.g. training.clip=0.5 or loss.fdr=0.05.
        callback: Called with progress.
    """
    settings = locals()
    for name in ("rows", "seeds", "control", "test", "device", "data", "validation"):
        settings[name] = _listed(settings[name])
    return _run("ablation", settings)


def merge(
    parts: Path | Sequence[Path],
    out: Path,
    *,
    copy: bool = False,
    partial: bool = False,
    callback: Callback | None = None,
) -> Report:
    """Join the parts of a dataset that were made with --shard.

    Args:
        parts: Folders of the parts.
        out: Folder of the whole dataset: new, from an earlier merge, or one of the parts.
        copy: Copy files instead of linking them.
        partial: Merge even if pairs or clips are missing; a later merge can add them.
        callback: Called with progress.
    """
    settings = locals()
    for name in ("parts",):
        settings[name] = _listed(settings[name])
    return _run("merge", settings)


def pack(
    dir: Path,
    out: Path,
    *,
    flow: str = "npy",
    shard_size: str = "1GB",
    stop_after: int | None = None,
    force: bool = False,
    callback: Callback | None = None,
) -> Report:
    """Pack a dataset into WebDataset tars, with an index and a dataset card, to publish and to stream.

    Args:
        dir: Folder of a complete dataset written by `srflow render` or `srflow shapes`.
        out: Folder of the packed dataset.
        flow: Flow: npy (float16), npy32 (float32), png (KITTI's 16-bit PNG) or npz16 (as `srflow render` writes it).
        shard_size: Approximate size of a tar: bytes, or with kB, MB or GB.
        stop_after: Stop after packing N pairs; the same command continues.
        force: Delete the packed dataset in the folder and start over.
        callback: Called with progress.
    """
    settings = locals()
    return _run("pack", settings)


def check(
    dir: Path,
    *,
    hashes: bool = False,
    rerender: str | None = None,
    seed: int | None = None,
    callback: Callback | None = None,
) -> Report:
    """Open every file of a dataset and report problems.

    Args:
        dir: Folder of a dataset written by `srflow render`; with --hashes also by `srflow shapes`, `srflow mer synth` or `synth-long`.
        hashes: Only compare every file with its hash, as `sha256sum -c SHA256SUMS` does.
        rerender: Only render N random pairs again and compare bytes; for datasets that need no other files.
        seed: Seed that draws the pairs of --rerender [default: from the clock].
        callback: Called with progress.
    """
    settings = locals()
    return _run("check", settings)


def eval(
    dataset: str,
    out: Path | None = None,
    *,
    split: str | None = None,
    method: str | Sequence[str] | None = None,
    crop: str | None = None,
    limit: str | None = None,
    batch: int = 1,
    regions: bool = False,
    small_motion: float | None = None,
    expression: bool = False,
    expression_error: bool = False,
    keep_going: bool = False,
    save_flow: Path | None = None,
    figure: Path | None = None,
    figure_pairs: str | Sequence[str] | None = None,
    force: bool = False,
    shard: str = "1/1",
    face: str | None = None,
    face_index: int | None = None,
    face_models: Path | None = None,
    face_box: str | None = None,
    landmarks: Path | None = None,
    rows: str | None = None,
    weights_dir: Path = ".",
    skip_missing: bool = False,
    refine: bool = False,
    start: str | None = None,
    weights: str | None = None,
    iters: str | None = None,
    set: dict[str, Any] | None = None,
    precision: str = "f32",
    device: str = "cpu",
    tile: str | None = None,
    tile_overlap: int = 128,
    scale: float | None = None,
    pyr_scale: float | None = None,
    levels: int | None = None,
    winsize: int | None = None,
    iterations: int | None = None,
    poly_n: int | None = None,
    poly_sigma: float | None = None,
    farneback_gaussian: bool = False,
    tau: float | None = None,
    lambda_: float | None = None,
    theta: float | None = None,
    nscales: int | None = None,
    warps: int | None = None,
    epsilon: float | None = None,
    inner_iterations: int | None = None,
    outer_iterations: int | None = None,
    scale_step: float | None = None,
    gamma: float | None = None,
    median_filtering: int | None = None,
    callback: Callback | None = None,
) -> Report:
    """Score estimators over a dataset and print the table.

    Args:
        dataset: Kind of dataset and its folder, e.g. sintel-clean:/data/Sintel.
        out: Also write scores.{txt,csv,json,tex,md}, pairs.csv and report.html into this folder.
        split: Split: train, val, test or all [default: the one that results are usually reported on].
        method: Methods to score: farneback, tvl1, srflow, raft, raft-small, gma, skflow, rpknet, dpflow, ccmr, ccmr-p, sea-raft-s, sea-raft-m, sea-raft-l, memflow, flownets, flownetc, flownetcss, flownet3-css, unimatch, unimatch-sc2, unimatch-sc2-ref6, ssa; networks with their weights, as in skflow=FILE; srflow has its own; files:DIR for flow files of another program; NAME:METHOD sets the name in tables, as in SRFlowNet:skflow=FILE; METHOD:iters=N sets the refinement iterations of one network [default: srflow].
        crop: Crop that is estimated and scored, centred on the head (without a mask, on the frame).
        limit: Score only N pairs, spread evenly over the dataset.
        batch: Pairs to estimate at once with a network, if they are consecutive and of one size; scores do not change, and each pair's time is an equal share of the batch's.
        regions: Also score the regions of `srflow render --regions`: skin, eyes, mouth, hair, neck, the rim of the head (3 px wide, in no other region) and the background.
        small_motion: Also score the pixels whose true flow is shorter than this, e.g. 0.5; with masks, only on the head.
        expression: Also score the motion of the expression: subtract the head's motion, the best affine fit within the mask (or the frame), from estimated and true flow, and compare the rest by correlation and strength.
        expression_error: Also score the flow of the expression: subtract the motion that most of the face follows from the estimated flow, as `srflow mer` does, and compare the rest with the exact flow of datasets of `srflow render --decompose` and `srflow mer synth`.
        keep_going: Leave out pairs that cannot be scored, for every method, and continue; the exit code is still 1.
        save_flow: Also write the flow of each method and pair, as DIR/METHOD/SCENE/FRAME.flo.
        figure: Also write a figure for a paper into this folder: figure.svg, figure.pdf and every panel as PNG; see also `srflow figure`.
        figure_pairs: Pairs in the figure, by their names in pairs.csv [default: 4, spread evenly].
        force: Overwrite these files.
        shard: Process only part I of N; `auto` reads I and N from the variables of Slurm and other job engines, `auto/N` only I, as for Kubernetes and PBS.
        face: Find the face with MediaPipe's networks, and write its landmarks next to the results; pass that file to `--landmarks` to repeat the run without the networks.
        face_index: Face to use if there are several; 1 is the leftmost.
        face_models: MediaPipe's networks: face_landmarker.task, its package as a folder or .whl file, or a folder with face_detection_short_range.tflite and face_landmark.tflite [default: $SRFLOW_FACE_MODELS, or the package that python3 has installed].
        face_box: Crop every frame to this box: LEFT,TOP,WIDTHxHEIGHT in pixels.
        landmarks: Align faces by the landmarks in this CSV file (dlib's 68 points or the eyes; see docs/guides/faces.md).
        rows: Methods with their names and weights: a TOML file, or one of paper-table-2, paper-table-3, paper-table-4, paper-table-6, paper-tables-7-to-10.
        weights_dir: Folder with the weights of --rows.
        skip_missing: Leave out rows whose weights or networks are missing; the table lists them.
        refine: Refine the flow of every method with TV-L1 at full size; one scale and one warp, unless --nscales and --warps are set; the other parameters of tvl1 apply too.
        start: Start networks from the flow of this method, such as tvl1 or raft-small=FILE, in place of their own start.
        weights: Weights of the network: a file (PyTorch, Lightning, safetensors), or the name of published weights, such as things; `srflow models` lists them.
        iters: Refinement iterations; auto does the network's own number at most, and stops once the flow moves less than 0.07 px, auto:PX less than PX [default: the network's own, see `srflow models`].
        set: Network setting that the weights do not store; `srflow models` lists them.
        precision: Numbers that networks multiply: `f16` and `bf16` are less exact, but faster on GPUs with matrix units for them; `bf16` is up to twice as fast on CPUs with AVX512-BF16; `auto` uses them only there. Sums, softmax, norms and flow are always f32.
        device: Device to compute on; this build has cpu.
        tile: Estimate tile by tile and blend the overlaps; `auto` uses the largest tiles that fit into free memory, or none if the whole frame fits.
        tile_overlap: Overlap of neighbouring tiles in pixels, up to half a tile.
        scale: Resize the frames by this factor before estimation, and the flow back to full size.
        pyr_scale: Size of a pyramid level relative to the next finer one [default: 0.5].
        levels: Pyramid levels in addition to the full size [default: 5].
        winsize: Side of the averaging window in pixels [default: 13].
        iterations: Iterations at each level [default: 10].
        poly_n: Radius of the polynomial fit in pixels [default: 5].
        poly_sigma: Standard deviation of the fit's weight in pixels [default: 1.1].
        farneback_gaussian: Use a Gaussian averaging window in place of a box.
        tau: Time step of the dual update [default: 0.25].
        lambda_: Weight of the data term; smaller is smoother [default: 0.15].
        theta: Tightness of the coupling of data term and smoothness [default: 0.3].
        nscales: Number of scales [default: 5].
        warps: Warps at each scale [default: 5].
        epsilon: Stop iterating when the flow changes by less than this, in pixels [default: 0.01].
        inner_iterations: Iterations between two median filters [default: 30].
        outer_iterations: Median filters after each warp [default: 10].
        scale_step: Size of a scale relative to the next finer one [default: 0.8].
        gamma: Weight of an additional brightness change; 0 disables it [default: 0].
        median_filtering: Side of the median filter, 3 or 5 pixels, or 1 for none [default: 5].
        callback: Called with progress.
    """
    settings = locals()
    for name in ("method", "figure_pairs"):
        settings[name] = _listed(settings[name])
    settings["lambda"] = settings.pop("lambda_")
    return _run("eval", settings)


def figure(
    *,
    output: Path | Sequence[Path] | None = None,
    panels: Path | None = None,
    dataset: str | None = None,
    split: str | None = None,
    samples: str | Sequence[str] | None = None,
    frames: Path | Sequence[Path] | None = None,
    truth: Path | None = None,
    flow: str | Sequence[str] | None = None,
    method: str | Sequence[str] | None = None,
    columns: str | Sequence[str] | None = None,
    crop: str | None = None,
    flow_scale: str = "auto",
    error_scale: str = "auto",
    strain_scale: str = "auto",
    arrows: int | None = None,
    titles: str | Sequence[str] | None = None,
    labels: str | Sequence[str] | None = None,
    captions: str | Sequence[str] | None = None,
    letters: bool = False,
    no_scores: bool = False,
    font_size: int = 8,
    width: str = "17.8cm",
    max_columns: int = 10,
    dpi: int = 600,
    force: bool = False,
    refine: bool = False,
    start: str | None = None,
    weights: str | None = None,
    iters: str | None = None,
    set: dict[str, Any] | None = None,
    precision: str = "f32",
    device: str = "cpu",
    tile: str | None = None,
    tile_overlap: int = 128,
    scale: float | None = None,
    pyr_scale: float | None = None,
    levels: int | None = None,
    winsize: int | None = None,
    iterations: int | None = None,
    poly_n: int | None = None,
    poly_sigma: float | None = None,
    farneback_gaussian: bool = False,
    tau: float | None = None,
    lambda_: float | None = None,
    theta: float | None = None,
    nscales: int | None = None,
    warps: int | None = None,
    epsilon: float | None = None,
    inner_iterations: int | None = None,
    outer_iterations: int | None = None,
    scale_step: float | None = None,
    gamma: float | None = None,
    median_filtering: int | None = None,
    callback: Callback | None = None,
) -> Report:
    """Make a figure for a paper: frames, flow, errors and strain in a grid.

    Args:
        output: Figures to write, as .pdf or .svg.
        panels: Also write every panel as a PNG of full size into this folder.
        dataset: Kind of dataset and its folder, as for `srflow eval`.
        split: Split: train, val, test or all [default: the one that results are usually reported on].
        samples: Pairs of the dataset, one row for each: their names in pairs.csv of `srflow eval`, or their numbers from 0 [default: 3, spread evenly].
        frames: Two frames instead of a dataset.
        truth: True flow between --frames, in any format of `srflow convert`.
        flow: Flow files between --frames, with the names of their methods.
        method: Methods to show: farneback, tvl1, srflow, raft, raft-small, gma, skflow, rpknet, dpflow, ccmr, ccmr-p, sea-raft-s, sea-raft-m, sea-raft-l, memflow, flownets, flownetc, flownetcss, flownet3-css, unimatch, unimatch-sc2, unimatch-sc2-ref6, ssa; networks with their weights, as in skflow=FILE; srflow has its own; files:DIR for flow files of another program; NAME:METHOD sets the name in tables, as in SRFlowNet:skflow=FILE; METHOD:iters=N sets the refinement iterations of one network.
        columns: Columns: see below [default: truth+frame1 flow+error; without truth: frame1 frame2 flow].
        crop: Show only this part of the frames: around the head (without a mask, in the middle), or from column X and row Y. Flow is estimated on whole frames; scores and scales are of the part.
        flow_scale: Flow length of full colour, in pixels: a number, `auto` (one scale for the figure) or `pair` (one for each pair).
        error_scale: Upper end of errors, in pixels, likewise.
        strain_scale: Upper end of strain, likewise.
        arrows: Draw an arrow on flow every STEP pixels; flow with full colour has arrows of that length.
        titles: Titles of the columns, one for each; may be empty [default: what they show].
        labels: Labels of the rows, one for each pair; may be empty [default: their names, if there are several].
        captions: Captions of the panels, from left to right and from top to bottom [default: the end-point error of methods].
        letters: Begin the captions of panels with (a), (b), .
        no_scores: Leave out the end-point errors.
        font_size: Size of titles and labels in points; captions are smaller.
        width: Width of the figure, in mm, cm, in, pt or bp (those of LaTeX), such as 252pt.
        max_columns: Maximum number of columns in a row; further columns start another row.
        dpi: Maximum resolution of pictures, in pixels per inch; finer pictures are averaged down.
        force: Overwrite these files.
        refine: Refine the flow of every method with TV-L1 at full size; one scale and one warp, unless --nscales and --warps are set; the other parameters of tvl1 apply too.
        start: Start networks from the flow of this method, such as tvl1 or raft-small=FILE, in place of their own start.
        weights: Weights of the network: a file (PyTorch, Lightning, safetensors), or the name of published weights, such as things; `srflow models` lists them.
        iters: Refinement iterations; auto does the network's own number at most, and stops once the flow moves less than 0.07 px, auto:PX less than PX [default: the network's own, see `srflow models`].
        set: Network setting that the weights do not store; `srflow models` lists them.
        precision: Numbers that networks multiply: `f16` and `bf16` are less exact, but faster on GPUs with matrix units for them; `bf16` is up to twice as fast on CPUs with AVX512-BF16; `auto` uses them only there. Sums, softmax, norms and flow are always f32.
        device: Device to compute on; this build has cpu.
        tile: Estimate tile by tile and blend the overlaps; `auto` uses the largest tiles that fit into free memory, or none if the whole frame fits.
        tile_overlap: Overlap of neighbouring tiles in pixels, up to half a tile.
        scale: Resize the frames by this factor before estimation, and the flow back to full size.
        pyr_scale: Size of a pyramid level relative to the next finer one [default: 0.5].
        levels: Pyramid levels in addition to the full size [default: 5].
        winsize: Side of the averaging window in pixels [default: 13].
        iterations: Iterations at each level [default: 10].
        poly_n: Radius of the polynomial fit in pixels [default: 5].
        poly_sigma: Standard deviation of the fit's weight in pixels [default: 1.1].
        farneback_gaussian: Use a Gaussian averaging window in place of a box.
        tau: Time step of the dual update [default: 0.25].
        lambda_: Weight of the data term; smaller is smoother [default: 0.15].
        theta: Tightness of the coupling of data term and smoothness [default: 0.3].
        nscales: Number of scales [default: 5].
        warps: Warps at each scale [default: 5].
        epsilon: Stop iterating when the flow changes by less than this, in pixels [default: 0.01].
        inner_iterations: Iterations between two median filters [default: 30].
        outer_iterations: Median filters after each warp [default: 10].
        scale_step: Size of a scale relative to the next finer one [default: 0.8].
        gamma: Weight of an additional brightness change; 0 disables it [default: 0].
        median_filtering: Side of the median filter, 3 or 5 pixels, or 1 for none [default: 5].
        callback: Called with progress.
    """
    settings = locals()
    for name in ("output", "samples", "frames", "flow", "method", "columns", "titles", "labels", "captions"):
        settings[name] = _listed(settings[name])
    settings["lambda"] = settings.pop("lambda_")
    return _run("figure", settings)


def view(
    thing: str,
    *,
    output: Path | None = None,
    serve: bool | int | None = None,
    split: str | None = None,
    limit: str | None = None,
    motion: str | None = None,
    seed: int = 1,
    force: bool = False,
    method: str | Sequence[str] | None = None,
    refine: bool = False,
    start: str | None = None,
    weights: str | None = None,
    iters: str | None = None,
    set: dict[str, Any] | None = None,
    precision: str = "f32",
    device: str = "cpu",
    tile: str | None = None,
    tile_overlap: int = 128,
    scale: float | None = None,
    pyr_scale: float | None = None,
    levels: int | None = None,
    winsize: int | None = None,
    iterations: int | None = None,
    poly_n: int | None = None,
    poly_sigma: float | None = None,
    farneback_gaussian: bool = False,
    tau: float | None = None,
    lambda_: float | None = None,
    theta: float | None = None,
    nscales: int | None = None,
    warps: int | None = None,
    epsilon: float | None = None,
    inner_iterations: int | None = None,
    outer_iterations: int | None = None,
    scale_step: float | None = None,
    gamma: float | None = None,
    median_filtering: int | None = None,
    callback: Callback | None = None,
) -> Report:
    """Show Gaussians, an avatar, a dataset or flow in a browser.

    Args:
        thing: What to show.
        output: The page to write [default: the name of the thing with .html, in this folder].
        serve: Serve the page on this machine instead of writing it, and load pairs on demand; without PORT, or with 0, on any free port.
        split: Split of a dataset: train, val, test or all [default: the one that results are usually reported on].
        limit: Show N pairs, spread evenly over the dataset [default: all if served, else as many as make 48 MB, at most 24].
        motion: Motion of a head: `own`, `curves`, or a file, as for `srflow rasterize` [default: own if it has one, else curves].
        seed: Seed of the person and of the random motion, for built-in heads.
        force: Overwrite the page.
        method: Methods whose flow is shown beside a dataset's: farneback, tvl1, srflow, raft, raft-small, gma, skflow, rpknet, dpflow, ccmr, ccmr-p, sea-raft-s, sea-raft-m, sea-raft-l, memflow, flownets, flownetc, flownetcss, flownet3-css, unimatch, unimatch-sc2, unimatch-sc2-ref6, ssa; networks with their weights, as in skflow=FILE; srflow has its own; files:DIR for flow files of another program; NAME:METHOD sets the name in tables, as in SRFlowNet:skflow=FILE; METHOD:iters=N sets the refinement iterations of one network.
        refine: Refine the flow of every method with TV-L1 at full size; one scale and one warp, unless --nscales and --warps are set; the other parameters of tvl1 apply too.
        start: Start networks from the flow of this method, such as tvl1 or raft-small=FILE, in place of their own start.
        weights: Weights of the network: a file (PyTorch, Lightning, safetensors), or the name of published weights, such as things; `srflow models` lists them.
        iters: Refinement iterations; auto does the network's own number at most, and stops once the flow moves less than 0.07 px, auto:PX less than PX [default: the network's own, see `srflow models`].
        set: Network setting that the weights do not store; `srflow models` lists them.
        precision: Numbers that networks multiply: `f16` and `bf16` are less exact, but faster on GPUs with matrix units for them; `bf16` is up to twice as fast on CPUs with AVX512-BF16; `auto` uses them only there. Sums, softmax, norms and flow are always f32.
        device: Device to compute on; this build has cpu.
        tile: Estimate tile by tile and blend the overlaps; `auto` uses the largest tiles that fit into free memory, or none if the whole frame fits.
        tile_overlap: Overlap of neighbouring tiles in pixels, up to half a tile.
        scale: Resize the frames by this factor before estimation, and the flow back to full size.
        pyr_scale: Size of a pyramid level relative to the next finer one [default: 0.5].
        levels: Pyramid levels in addition to the full size [default: 5].
        winsize: Side of the averaging window in pixels [default: 13].
        iterations: Iterations at each level [default: 10].
        poly_n: Radius of the polynomial fit in pixels [default: 5].
        poly_sigma: Standard deviation of the fit's weight in pixels [default: 1.1].
        farneback_gaussian: Use a Gaussian averaging window in place of a box.
        tau: Time step of the dual update [default: 0.25].
        lambda_: Weight of the data term; smaller is smoother [default: 0.15].
        theta: Tightness of the coupling of data term and smoothness [default: 0.3].
        nscales: Number of scales [default: 5].
        warps: Warps at each scale [default: 5].
        epsilon: Stop iterating when the flow changes by less than this, in pixels [default: 0.01].
        inner_iterations: Iterations between two median filters [default: 30].
        outer_iterations: Median filters after each warp [default: 10].
        scale_step: Size of a scale relative to the next finer one [default: 0.8].
        gamma: Weight of an additional brightness change; 0 disables it [default: 0].
        median_filtering: Side of the median filter, 3 or 5 pixels, or 1 for none [default: 5].
        callback: Called with progress.
    """
    settings = locals()
    for name in ("method",):
        settings[name] = _listed(settings[name])
    settings["lambda"] = settings.pop("lambda_")
    return _run("view", settings)


def avatar_capture(
    out: Path,
    *,
    head: str = "builtin",
    look: int = 2,
    cameras: int = 16,
    timesteps: int = 100,
    size: str = "550x802",
    background: str = "#ffffff",
    noise: float = 0,
    calibration_noise: float = 0,
    landmark_noise: float = 0,
    seed: int = 1,
    shard: str = "1/1",
    stop_after: int | None = None,
    force: bool = False,
    callback: Callback | None = None,
) -> Report:
    """Render a moving head for many cameras, in the files that VHAP exports and GaussianAvatars is trained on.

    Args:
        out: Folder of the capture.
        head: Head model: `builtin` (a head sculpted by code from a seed), `ict:DIR` (ICT-FaceKit's FaceXModel folder), `builtin-average` (the average built-in head, whose identity basis are the traits of persons), `flame:FILE` (FLAME 2020 or 2023 (.pkl or .npz) with VHAP's teeth), `flame-toothless:FILE` (FLAME as published), `gnm:FILE` (GNM Head 3 (gnm_head.npz)), `gltf:FILE` (any head as .glb or .gltf), `obj:FILE` (any mesh as Wavefront .obj, such as a scan), `lam:DIR|ZIP` (an avatar of LAM: skin.glb and offset.ply), `avatar:DIR` (a trained avatar: point_cloud.ply and flame_param.npz; DIR@HEAD where no head.json names its head model).
        look: Version of how heads look; 1 keeps the bytes of earlier datasets.
        cameras: Number of cameras, 1 to 16, always including the front camera, number 8.
        timesteps: Number of timesteps.
        size: Size of the pictures, WIDTHxHEIGHT.
        background: Background colour: white, black, #rrggbb or R,G,B (0 to 255 each).
        noise: Sensor noise on the head; 1 is a standard deviation of about 1.8 of 255 in mid-grey.
        calibration_noise: Error of the cameras in transforms.json; 1 is about half a pixel at 550x802.
        landmark_noise: Standard deviation of the landmarks in landmarks.csv, in pixels.
        seed: Random seed of the person, the motion and the noise.
        shard: Process only part I of N; `auto` reads I and N from the variables of Slurm and other job engines, `auto/N` only I, as for Kubernetes and PBS.
        stop_after: Stop after N pairs, clips or timesteps; the same command continues.
        force: Delete the dataset in the folder and start over.
        callback: Called with progress.
    """
    settings = locals()
    return _run("avatar capture", settings)


def avatar_import(
    pictures: Path,
    out: Path,
    *,
    pattern: str | None = None,
    masks: str | None = None,
    cameras: Path | None = None,
    metres_per_unit: float = 1,
    force: bool = False,
    frames: int | None = None,
    focal: float | None = None,
    face_index: int | None = None,
    face_models: Path | None = None,
    callback: Callback | None = None,
) -> Report:
    """Make a capture from a video of one person, or from pictures and a file of their cameras.

    Args:
        pictures: Folder of the pictures, or a video.
        out: Folder to write.
        pattern: Names of the pictures below PICTURES, with {camera} and {timestep}; without an extension, PNG and JPEG.
        masks: Names of the masks below PICTURES, white on the head.
        cameras: File of the cameras, or folder of a COLMAP model.
        metres_per_unit: Metres per unit of the cameras.
        force: Overwrite the lists in the folder.
        frames: Use at most this many frames, spread over the video [default: 240].
        focal: Focal length in pixels [default: recorded in the video, else 1.1 longer sides].
        face_index: Face to follow if there are several; 1 is the leftmost.
        face_models: MediaPipe's networks: face_landmarker.task, its package as a folder or .whl file, or a folder with face_detection_short_range.tflite and face_landmark.tflite [default: $SRFLOW_FACE_MODELS, or the package that python3 has installed].
        callback: Called with progress.
    """
    settings = locals()
    return _run("avatar import", settings)


def avatar_fit(
    data: Path,
    model: str,
    out: Path,
    *,
    landmarks: Path | None = None,
    landmarks_of: str | Sequence[str] | None = None,
    cameras: int | Sequence[int] | None = None,
    noise: float | None = None,
    eye_distance: float | None = None,
    photometric: bool = False,
    identities: int = 100,
    expressions: int = 100,
    seed: int = 1,
    truth: Path | None = None,
    force: bool = False,
    callback: Callback | None = None,
) -> Report:
    """Fit a head model to the landmarks of a capture.

    Args:
        data: Folder of the capture: transforms.json or transforms_train.json with its cameras, and landmarks.csv.
        model: Head model: `builtin` (a head sculpted by code from a seed), `ict:DIR` (ICT-FaceKit's FaceXModel folder), `builtin-average` (the average built-in head, whose identity basis are the traits of persons), `flame:FILE` (FLAME 2020 or 2023 (.pkl or .npz) with VHAP's teeth), `flame-toothless:FILE` (FLAME as published), `gnm:FILE` (GNM Head 3 (gnm_head.npz)), `gltf:FILE` (any head as .glb or .gltf), `obj:FILE` (any mesh as Wavefront .obj, such as a scan), `lam:DIR|ZIP` (an avatar of LAM: skin.glb and offset.ply), `avatar:DIR` (a trained avatar: point_cloud.ply and flame_param.npz; DIR@HEAD where no head.json names its head model).
        out: Folder to write.
        landmarks: Landmarks: a table like landmarks.csv, or a folder of iBUG's .pts files named like the pictures [default: DATA/landmarks.csv].
        landmarks_of: Landmarks of one camera, as OpenFace writes them, or MediaPipe's as columns x_0, y_0, ...; may be repeated.
        cameras: Use only these cameras.
        noise: Standard deviation of the landmarks, in pixels [default: estimated].
        eye_distance: Distance between the pupils in millimetres, about 63 in adults; gives the scale that a single camera cannot see.
        photometric: Then align the pictures with each other by the colours of the skin, turn the eyes to the irises, and close the lids.
        identities: Fit at most this many shapes of the identity basis.
        expressions: Fit at most this many shapes of the expression basis.
        seed: Seed of a built-in head.
        truth: Compare the mesh with the true one in this capture of `srflow avatar capture`; may be DATA itself.
        force: Overwrite an earlier fit in the folder.
        callback: Called with progress.
    """
    settings = locals()
    for name in ("landmarks_of", "cameras"):
        settings[name] = _listed(settings[name])
    return _run("avatar fit", settings)


def avatar_from_video(
    video: Path,
    out: Path,
    config: Path = "video",
    *,
    model: str = "builtin-average",
    eye_distance: float | None = None,
    iterations: int | None = None,
    force: bool = False,
    frames: int | None = None,
    focal: float | None = None,
    face_index: int | None = None,
    face_models: Path | None = None,
    callback: Callback | None = None,
) -> Report:
    """Make an avatar from a video of one person.

    Args:
        video: Video of one person.
        out: Folder to write.
        config: Preset or TOML file of the training.
        model: Head model: `builtin` (a head sculpted by code from a seed), `ict:DIR` (ICT-FaceKit's FaceXModel folder), `builtin-average` (the average built-in head, whose identity basis are the traits of persons), `flame:FILE` (FLAME 2020 or 2023 (.pkl or .npz) with VHAP's teeth), `flame-toothless:FILE` (FLAME as published), `gnm:FILE` (GNM Head 3 (gnm_head.npz)), `gltf:FILE` (any head as .glb or .gltf), `obj:FILE` (any mesh as Wavefront .obj, such as a scan), `lam:DIR|ZIP` (an avatar of LAM: skin.glb and offset.ply), `avatar:DIR` (a trained avatar: point_cloud.ply and flame_param.npz; DIR@HEAD where no head.json names its head model).
        eye_distance: Distance between the pupils in millimetres, about 63 in adults; gives the scale that a single camera cannot see.
        iterations: Number of iterations of the training.
        force: Delete what an earlier run has left in the folder and start over.
        frames: Use at most this many frames, spread over the video [default: 240].
        focal: Focal length in pixels [default: recorded in the video, else 1.1 longer sides].
        face_index: Face to follow if there are several; 1 is the leftmost.
        face_models: MediaPipe's networks: face_landmarker.task, its package as a folder or .whl file, or a folder with face_detection_short_range.tflite and face_landmark.tflite [default: $SRFLOW_FACE_MODELS, or the package that python3 has installed].
        callback: Called with progress.
    """
    settings = locals()
    return _run("avatar from-video", settings)


def avatar_train(
    out: Path | None = None,
    config: Path | None = None,
    *,
    data: Path | None = None,
    resume: Path | None = None,
    model: str | None = None,
    subject: int | None = None,
    print_config: bool = False,
    checkpoint_every: float = 2,
    stop_after: int | None = None,
    iterations: int | None = None,
    seed: int | None = None,
    strategy: str | None = None,
    antialiased: bool = False,
    faithful: bool = False,
    set: dict[str, Any] | None = None,
    callback: Callback | None = None,
) -> Report:
    """Train an avatar of 3D Gaussians on a capture.

    Args:
        out: Folder of the run, new or empty.
        config: Preset (gaussian-avatars, cpu, video) or TOML file to start from [default: gaussian-avatars].
        data: Folder of the capture, as VHAP exports it.
        resume: Continue the run in this folder from its last checkpoint; pass DATA and --model if the capture or head model has moved.
        model: Head model: `builtin` (a head sculpted by code from a seed), `ict:DIR` (ICT-FaceKit's FaceXModel folder), `builtin-average` (the average built-in head, whose identity basis are the traits of persons), `flame:FILE` (FLAME 2020 or 2023 (.pkl or .npz) with VHAP's teeth), `flame-toothless:FILE` (FLAME as published), `gnm:FILE` (GNM Head 3 (gnm_head.npz)), `gltf:FILE` (any head as .glb or .gltf), `obj:FILE` (any mesh as Wavefront .obj, such as a scan), `lam:DIR|ZIP` (an avatar of LAM: skin.glb and offset.ply), `avatar:DIR` (a trained avatar: point_cloud.ply and flame_param.npz; DIR@HEAD where no head.json names its head model) [default: the one that head.json of the capture names].
        subject: Seed of a built-in head [default: that in head.json of the capture, else 1].
        print_config: Print the configuration with every key instead of training, as TOML or JSON.
        checkpoint_every: Minimum time between two checkpoints.
        stop_after: Write a checkpoint and stop after this iteration or up to 100 later; --resume continues.
        iterations: Number of iterations, one picture each; all that the configuration schedules moves along.
        seed: Random seed.
        strategy: Strategy that adds and removes Gaussians: default (3D Gaussian Splatting), absgs or mcmc.
        antialiased: Render Gaussians smaller than a pixel antialiased; see docs/guides/rasterize.md.
        faithful: Keep the defects of GaussianAvatars' code, listed in docs/explanation/avatars.md.
        set: Any key of the configuration, e.g. ssim_weight=0.1 or density.until=15000.
        callback: Called with progress.
    """
    settings = locals()
    return _run("avatar train", settings)


def avatar_eval(
    avatar: str,
    capture: Path,
    out: Path | None = None,
    *,
    split: str | Sequence[str] | None = None,
    flow: bool = False,
    step: int | Sequence[int] | None = None,
    truth: Path | None = None,
    limit: int | None = None,
    background: str | None = None,
    faithful: bool = False,
    sort_per_pixel: bool = False,
    force: bool = False,
    callback: Callback | None = None,
) -> Report:
    """Score a trained avatar on its capture: its pictures, and how exact its flow is.

    Args:
        avatar: Folder of the avatar or of its training; DIR@HEAD if it has no head.json.
        capture: Folder of the avatar's training capture.
        out: Also write eval.json, report.html and pictures into this folder.
        split: Pictures to score: val (held-out camera), test (held-out timesteps), train.
        flow: Also compare the avatar's flow and mesh with the true ones.
        step: Timesteps between the two pictures of a pair.
        truth: Original capture with the true head, if CAPTURE is a fit of it [default: CAPTURE].
        limit: Score N random pictures of each split and N random pairs of each split and step, the same in every run.
        background: Colour behind the head in the pictures: white, black, #rrggbb or R,G,B (0 to 255 each) [default: that of the training, if AVATAR is one, else white].
        faithful: Ignore principal points and use one focal length, as GaussianAvatars does; on if the training did.
        sort_per_pixel: Sort the Gaussians at each pixel; on if the training did.
        force: Overwrite these files.
        callback: Called with progress.
    """
    settings = locals()
    for name in ("split", "step"):
        settings[name] = _listed(settings[name])
    return _run("avatar eval", settings)


def avatar_mesh(
    model: str,
    output: Path,
    *,
    params: Path | None = None,
    action_units: str | None = None,
    timestep: int = 0,
    seed: int = 1,
    force: bool = False,
    callback: Callback | None = None,
) -> Report:
    """Write the mesh of a head model in some shape and pose.

    Args:
        model: Head model: `builtin` (a head sculpted by code from a seed), `ict:DIR` (ICT-FaceKit's FaceXModel folder), `builtin-average` (the average built-in head, whose identity basis are the traits of persons), `flame:FILE` (FLAME 2020 or 2023 (.pkl or .npz) with VHAP's teeth), `flame-toothless:FILE` (FLAME as published), `gnm:FILE` (GNM Head 3 (gnm_head.npz)), `gltf:FILE` (any head as .glb or .gltf), `obj:FILE` (any mesh as Wavefront .obj, such as a scan), `lam:DIR|ZIP` (an avatar of LAM: skin.glb and offset.ply), `avatar:DIR` (a trained avatar: point_cloud.ply and flame_param.npz; DIR@HEAD where no head.json names its head model).
        output: File to write: .obj, .ply or .glb.
        params: Parameters, .npz or .json [default: the head at rest].
        action_units: Action units instead of parameters, 0 to 1 each, such as 6=0.5,12_L=1.
        timestep: Timestep of the parameters, from 0.
        seed: Seed of a built-in head.
        force: Overwrite the file.
        callback: Called with progress.
    """
    settings = locals()
    return _run("avatar mesh", settings)


def avatar_export(
    output: Path,
    *,
    head: str | None = None,
    motion: str | None = None,
    timestep: int | None = None,
    action_units: str | None = None,
    seed: int = 1,
    no_mesh: bool = False,
    animate: int | None = None,
    fps: int = 25,
    camera: Path | None = None,
    size: str | None = None,
    ply_up: str = "y",
    force: bool = False,
    callback: Callback | None = None,
) -> Report:
    """Write the Gaussians of a head in some pose, for viewers and other programs.

    Args:
        output: File to write: .ply, .splat, .spz or .glb.
        head: Head, instead of a file of Gaussians: `builtin` (a head sculpted by code from a seed), `ict:DIR` (ICT-FaceKit's FaceXModel folder), `builtin-average` (the average built-in head, whose identity basis are the traits of persons), `flame:FILE` (FLAME 2020 or 2023 (.pkl or .npz) with VHAP's teeth), `flame-toothless:FILE` (FLAME as published), `gnm:FILE` (GNM Head 3 (gnm_head.npz)), `gltf:FILE` (any head as .glb or .gltf), `obj:FILE` (any mesh as Wavefront .obj, such as a scan), `lam:DIR|ZIP` (an avatar of LAM: skin.glb and offset.ply), `avatar:DIR` (a trained avatar: point_cloud.ply and flame_param.npz; DIR@HEAD where no head.json names its head model).
        motion: Motion of the head: `own` (the avatar's training motion), the flame_param.npz, capture or clip (FILE.glb@CLIP) of another subject with the same kind of head, or `curves` (10 s of random motion at 24 frames per second) [default: own if it has one, else curves].
        timestep: Timestep of the motion in this frame, from 0.
        action_units: Action units in place of a motion, 0 to 1 each, such as 6=0.5,12_L=1.
        seed: Seed of the person and of the random motion, for built-in heads.
        no_mesh: Leave the mesh out of a .glb.
        animate: Animate the mesh of a .glb over N timesteps, starting at --timestep.
        fps: Timesteps per second of --animate.
        camera: Cameras to write into a .glb: any file that `srflow rasterize --camera` reads.
        size: Size of the pictures, if CAM does not store it.
        ply_up: Up direction of the .ply: y, as for srflow's heads, or -y, as many viewers expect.
        force: Overwrite the file.
        callback: Called with progress.
    """
    settings = locals()
    return _run("avatar export", settings)


def avatar_units(
    model: str,
    *,
    seed: int = 1,
    output: Path | None = None,
    force: bool = False,
    callback: Callback | None = None,
) -> Report:
    """Show how well a head model does each action unit, and write its table of units.

    Args:
        model: Head model: `builtin` (a head sculpted by code from a seed), `ict:DIR` (ICT-FaceKit's FaceXModel folder), `builtin-average` (the average built-in head, whose identity basis are the traits of persons), `flame:FILE` (FLAME 2020 or 2023 (.pkl or .npz) with VHAP's teeth), `flame-toothless:FILE` (FLAME as published), `gnm:FILE` (GNM Head 3 (gnm_head.npz)), `gltf:FILE` (any head as .glb or .gltf), `obj:FILE` (any mesh as Wavefront .obj, such as a scan), `lam:DIR|ZIP` (an avatar of LAM: skin.glb and offset.ply), `avatar:DIR` (a trained avatar: point_cloud.ply and flame_param.npz; DIR@HEAD where no head.json names its head model).
        seed: Seed of a built-in head.
        output: Table to write (.json): expression weights and joint rotations of each unit.
        force: Overwrite the file.
        callback: Called with progress.
    """
    settings = locals()
    return _run("avatar units", settings)


def avatar_landmarks(
    model: str,
    out: Path,
    *,
    seed: int = 1,
    viz: Path | None = None,
    force: bool = False,
    face_models: Path | None = None,
    callback: Callback | None = None,
) -> Report:
    """Find the 68 landmarks of a head model without any.

    Args:
        model: Head model: `builtin` (a head sculpted by code from a seed), `ict:DIR` (ICT-FaceKit's FaceXModel folder), `builtin-average` (the average built-in head, whose identity basis are the traits of persons), `flame:FILE` (FLAME 2020 or 2023 (.pkl or .npz) with VHAP's teeth), `flame-toothless:FILE` (FLAME as published), `gnm:FILE` (GNM Head 3 (gnm_head.npz)), `gltf:FILE` (any head as .glb or .gltf), `obj:FILE` (any mesh as Wavefront .obj, such as a scan), `lam:DIR|ZIP` (an avatar of LAM: skin.glb and offset.ply), `avatar:DIR` (a trained avatar: point_cloud.ply and flame_param.npz; DIR@HEAD where no head.json names its head model).
        out: File to write: 68 rows in dlib's order, each with three vertices and their weights.
        seed: Seed of a built-in head.
        viz: Draw the landmarks into the picture of the mesh.
        force: Overwrite existing files.
        face_models: MediaPipe's networks: face_landmarker.task, its package as a folder or .whl file, or a folder with face_detection_short_range.tflite and face_landmark.tflite [default: $SRFLOW_FACE_MODELS, or the package that python3 has installed].
        callback: Called with progress.
    """
    settings = locals()
    return _run("avatar landmarks", settings)


def mer_data(
    datasets: str | Sequence[str],
    *,
    annotations: str | Sequence[str] | None = None,
    apex_list: Path | None = None,
    classes: str = "3",
    allow_missing: bool = False,
    only_key_frames: bool = False,
    labels_only: bool = False,
    clips: bool = False,
    callback: Callback | None = None,
) -> Report:
    """List micro-expression datasets: labels, counts, dropped rows with reasons, missing frames.

    Args:
        datasets: Datasets.
        annotations: Annotation file outside its dataset's folder, such as samm:FILE or clips:FILE.
        apex_list: CSV list of apex frames, for clips without a usable one [default: SMIC's smic_apex.csv or data_apex.csv in its folder].
        classes: Classes: a name (see below), or your own TOML file (docs/reference/micro-expression-files.md).
        allow_missing: Tolerate missing frames; clips without onset or apex are dropped.
        only_key_frames: Accept clips that contain only the onset, apex and offset frames.
        labels_only: Read only the annotations; do not look for frames.
        clips: List every clip.
        callback: Called with progress.
    """
    settings = locals()
    for name in ("datasets", "annotations"):
        settings[name] = _listed(settings[name])
    return _run("mer data", settings)


def mer_synth(
    out: Path,
    *,
    subjects: int = 12,
    clips: int = 6,
    side: int = 256,
    fps: float = 200,
    intensity: float = 1,
    noise: float = 1,
    drift: float = 1,
    lighting: float = 1,
    blinks: float = 0,
    glances: float = 0,
    speech: float = 0,
    nods: float = 0,
    breathing: float = 0,
    head: str | Sequence[str] | None = None,
    look: int = 2,
    seed: int = 1,
    flow_format: str = "flo",
    only_key_frames: bool = False,
    shard: str = "1/1",
    stop_after: int | None = None,
    force: bool = False,
    callback: Callback | None = None,
) -> Report:
    """Render a labelled micro-expression dataset.

    Args:
        out: Folder of the dataset.
        subjects: Number of subjects.
        clips: Clips per subject; negative, positive and surprise alternate.
        side: Width and height of the frames in pixels.
        fps: Frames per second.
        intensity: Strength of the expressions; 1 is 12 to 40 % of an action unit's full strength.
        noise: Sensor noise; 1 is a standard deviation of about 1.8 of 255 in mid-grey, growing with brightness.
        drift: Head drift within a clip; 1 is up to 0.1 degrees and 0.15 mm to either side.
        lighting: Illumination changes; 1 is slow changes of up to 2 %, with a gradient over the face, and 0.3 % flicker at 100 Hz.
        blinks: How far blinks close the lids, 0 to 1; one every 1.6 to 5.5 seconds.
        glances: Strength of glances, 0 to 2; 1 turns the eyes by up to 18 degrees.
        speech: Strength of speech, 0 to 2; sentences of 1 to 3 seconds with pauses of 1 to 4.
        nods: Strength of nods and shakes of the head, 0 to 2; 1 is up to 5 degrees, every 4 to 12 seconds.
        breathing: Strength of breathing, 0 to 2; 1 lifts the head by up to 1.2 mm, 12 to 20 times a minute.
        head: Head model; may be repeated, and the subjects show them in turn: `builtin` (a head sculpted by code from a seed), `ict:DIR` (ICT-FaceKit's FaceXModel folder), `builtin-average` (the average built-in head, whose identity basis are the traits of persons), `flame:FILE` (FLAME 2020 or 2023 (.pkl or .npz) with VHAP's teeth), `flame-toothless:FILE` (FLAME as published), `gnm:FILE` (GNM Head 3 (gnm_head.npz)), `gltf:FILE` (any head as .glb or .gltf), `obj:FILE` (any mesh as Wavefront .obj, such as a scan), `lam:DIR|ZIP` (an avatar of LAM: skin.glb and offset.ply), `avatar:DIR` (a trained avatar: point_cloud.ply and flame_param.npz; DIR@HEAD where no head.json names its head model).
        look: Version of how heads look; 1 keeps the bytes of earlier datasets.
        seed: Random seed.
        flow_format: File format of the true flow.
        only_key_frames: Write the onset and apex frames alone: all that features need.
        shard: Process only part I of N; `auto` reads I and N from the variables of Slurm and other job engines, `auto/N` only I, as for Kubernetes and PBS.
        stop_after: Stop after N pairs, clips or timesteps; the same command continues.
        force: Delete the dataset in the folder and start over.
        callback: Called with progress.
    """
    settings = locals()
    for name in ("head",):
        settings[name] = _listed(settings[name])
    return _run("mer synth", settings)


def mer_synth_long(
    out: Path,
    *,
    subjects: int = 4,
    minutes: float = 1,
    side: int = 192,
    fps: float = 30,
    intensity: float = 1,
    noise: float = 1,
    drift: float = 1,
    lighting: float = 1,
    blinks: float = 1,
    glances: float = 1,
    speech: float = 1,
    nods: float = 0,
    breathing: float = 0,
    head: str | Sequence[str] | None = None,
    look: int = 2,
    seed: int = 1,
    shard: str = "1/1",
    stop_after: int | None = None,
    force: bool = False,
    callback: Callback | None = None,
) -> Report:
    """Render long videos with micro- and macro-expressions, for spotting.

    Args:
        out: Folder of the videos.
        subjects: Number of videos, each of another subject.
        minutes: Length of each video.
        side: Width and height of the frames in pixels.
        fps: Frames per second.
        intensity: Strength of the micro-expressions; 1 is 12 to 40 % of an action unit's full strength.
        noise: Sensor noise; 1 is a standard deviation of about 1.8 of 255 in mid-grey, growing with brightness.
        drift: Head motion; 1 is up to 1.5 degrees and 2 mm to either side, within seconds.
        lighting: Illumination changes; 1 is slow changes of up to 2 %, with a gradient over the face, and 0.3 % flicker at 100 Hz.
        blinks: How far blinks close the lids, 0 to 1; one every 1.6 to 5.5 seconds.
        glances: Strength of glances, 0 to 2; 1 turns the eyes by up to 18 degrees.
        speech: Strength of speech, 0 to 2; a short sentence now and then.
        nods: Strength of nods and shakes of the head, 0 to 2; 1 is up to 5 degrees, every 4 to 12 seconds.
        breathing: Strength of breathing, 0 to 2; 1 lifts the head by up to 1.2 mm, 12 to 20 times a minute.
        head: Head model; may be repeated, and the subjects show them in turn: `builtin` (a head sculpted by code from a seed), `ict:DIR` (ICT-FaceKit's FaceXModel folder), `builtin-average` (the average built-in head, whose identity basis are the traits of persons), `flame:FILE` (FLAME 2020 or 2023 (.pkl or .npz) with VHAP's teeth), `flame-toothless:FILE` (FLAME as published), `gnm:FILE` (GNM Head 3 (gnm_head.npz)), `gltf:FILE` (any head as .glb or .gltf), `obj:FILE` (any mesh as Wavefront .obj, such as a scan), `lam:DIR|ZIP` (an avatar of LAM: skin.glb and offset.ply), `avatar:DIR` (a trained avatar: point_cloud.ply and flame_param.npz; DIR@HEAD where no head.json names its head model).
        look: Version of how heads look; 1 keeps the bytes of earlier datasets.
        seed: Random seed.
        shard: Process only part I of N; `auto` reads I and N from the variables of Slurm and other job engines, `auto/N` only I, as for Kubernetes and PBS.
        stop_after: Stop after N pairs, clips or timesteps; the same command continues.
        force: Delete the dataset in the folder and start over.
        callback: Called with progress.
    """
    settings = locals()
    for name in ("head",):
        settings[name] = _listed(settings[name])
    return _run("mer synth-long", settings)


def mer_apex(
    datasets: str | Sequence[str],
    out: Path | None = None,
    *,
    rule: str = "course",
    method: str = "srflow",
    resize: str | None = None,
    head_motion: str = "subtract",
    curves: Path | None = None,
    force: bool = False,
    annotations: str | Sequence[str] | None = None,
    apex_list: Path | None = None,
    classes: str = "3",
    allow_missing: bool = False,
    only_key_frames: bool = False,
    face: str | None = None,
    face_index: int | None = None,
    face_models: Path | None = None,
    face_box: str | None = None,
    landmarks: Path | None = None,
    refine: bool = False,
    start: str | None = None,
    weights: str | None = None,
    iters: str | None = None,
    set: dict[str, Any] | None = None,
    precision: str = "f32",
    device: str = "cpu",
    tile: str | None = None,
    tile_overlap: int = 128,
    scale: float | None = None,
    pyr_scale: float | None = None,
    levels: int | None = None,
    winsize: int | None = None,
    iterations: int | None = None,
    poly_n: int | None = None,
    poly_sigma: float | None = None,
    farneback_gaussian: bool = False,
    tau: float | None = None,
    lambda_: float | None = None,
    theta: float | None = None,
    nscales: int | None = None,
    warps: int | None = None,
    epsilon: float | None = None,
    inner_iterations: int | None = None,
    outer_iterations: int | None = None,
    scale_step: float | None = None,
    gamma: float | None = None,
    median_filtering: int | None = None,
    callback: Callback | None = None,
) -> Report:
    """Spot apex frames, and compare them with the annotated ones.

    Args:
        datasets: Datasets.
        out: Write the apex frames as a CSV list.
        rule: Rule: course, strain or ratio.
        method: For the rules `course` and `strain`. How to estimate the flow: farneback, tvl1, srflow, raft, raft-small, gma, skflow, rpknet, dpflow, ccmr, ccmr-p, sea-raft-s, sea-raft-m, sea-raft-l, memflow, flownets, flownetc, flownetcss, flownet3-css, unimatch, unimatch-sc2, unimatch-sc2-ref6, ssa; a network followed by its weights, as in raft=FILE; srflow has its own.
        resize: Resize to 112x112: the frames before estimating the flow, or the flow after [default: after].
        head_motion: The head's motion in the flow: keep or subtract.
        curves: Write the rule's curve of every frame as CSV.
        force: Overwrite existing files.
        annotations: Annotation file outside its dataset's folder, such as samm:FILE or clips:FILE.
        apex_list: CSV list of apex frames, for clips without a usable one [default: SMIC's smic_apex.csv or data_apex.csv in its folder].
        classes: Classes: a name (see below), or your own TOML file (docs/reference/micro-expression-files.md).
        allow_missing: Tolerate missing frames; clips without onset or apex are dropped.
        only_key_frames: Accept clips that contain only the onset, apex and offset frames.
        face: Find the face with MediaPipe's networks, and write its landmarks next to the results; pass that file to `--landmarks` to repeat the run without the networks.
        face_index: Face to use if there are several; 1 is the leftmost.
        face_models: MediaPipe's networks: face_landmarker.task, its package as a folder or .whl file, or a folder with face_detection_short_range.tflite and face_landmark.tflite [default: $SRFLOW_FACE_MODELS, or the package that python3 has installed].
        face_box: Crop every frame to this box: LEFT,TOP,WIDTHxHEIGHT in pixels.
        landmarks: Align faces by the landmarks in this CSV file (dlib's 68 points or the eyes; see docs/guides/faces.md).
        refine: Refine the flow of every method with TV-L1 at full size; one scale and one warp, unless --nscales and --warps are set; the other parameters of tvl1 apply too.
        start: Start networks from the flow of this method, such as tvl1 or raft-small=FILE, in place of their own start.
        weights: Weights of the network: a file (PyTorch, Lightning, safetensors), or the name of published weights, such as things; `srflow models` lists them.
        iters: Refinement iterations; auto does the network's own number at most, and stops once the flow moves less than 0.07 px, auto:PX less than PX [default: the network's own, see `srflow models`].
        set: Network setting that the weights do not store; `srflow models` lists them.
        precision: Numbers that networks multiply: `f16` and `bf16` are less exact, but faster on GPUs with matrix units for them; `bf16` is up to twice as fast on CPUs with AVX512-BF16; `auto` uses them only there. Sums, softmax, norms and flow are always f32.
        device: Device to compute on; this build has cpu.
        tile: Estimate tile by tile and blend the overlaps; `auto` uses the largest tiles that fit into free memory, or none if the whole frame fits.
        tile_overlap: Overlap of neighbouring tiles in pixels, up to half a tile.
        scale: Resize the frames by this factor before estimation, and the flow back to full size.
        pyr_scale: Size of a pyramid level relative to the next finer one [default: 0.5].
        levels: Pyramid levels in addition to the full size [default: 5].
        winsize: Side of the averaging window in pixels [default: 13].
        iterations: Iterations at each level [default: 10].
        poly_n: Radius of the polynomial fit in pixels [default: 5].
        poly_sigma: Standard deviation of the fit's weight in pixels [default: 1.1].
        farneback_gaussian: Use a Gaussian averaging window in place of a box.
        tau: Time step of the dual update [default: 0.25].
        lambda_: Weight of the data term; smaller is smoother [default: 0.15].
        theta: Tightness of the coupling of data term and smoothness [default: 0.3].
        nscales: Number of scales [default: 5].
        warps: Warps at each scale [default: 5].
        epsilon: Stop iterating when the flow changes by less than this, in pixels [default: 0.01].
        inner_iterations: Iterations between two median filters [default: 30].
        outer_iterations: Median filters after each warp [default: 10].
        scale_step: Size of a scale relative to the next finer one [default: 0.8].
        gamma: Weight of an additional brightness change; 0 disables it [default: 0].
        median_filtering: Side of the median filter, 3 or 5 pixels, or 1 for none [default: 5].
        callback: Called with progress.
    """
    settings = locals()
    for name in ("datasets", "annotations"):
        settings[name] = _listed(settings[name])
    settings["lambda"] = settings.pop("lambda_")
    return _run("mer apex", settings)


def mer_spot(
    videos: Path | Sequence[Path],
    out: Path,
    *,
    force: bool = False,
    shard: str = "1/1",
    fps: float | None = None,
    method: str = "farneback",
    head_motion: str = "subtract",
    micro_score: float = 3.2,
    macro_score: float = 20,
    face: str | None = None,
    face_index: int | None = None,
    face_models: Path | None = None,
    face_box: str | None = None,
    landmarks: Path | None = None,
    refine: bool = False,
    start: str | None = None,
    weights: str | None = None,
    iters: str | None = None,
    set: dict[str, Any] | None = None,
    precision: str = "f32",
    device: str = "cpu",
    tile: str | None = None,
    tile_overlap: int = 128,
    scale: float | None = None,
    pyr_scale: float | None = None,
    levels: int | None = None,
    winsize: int | None = None,
    iterations: int | None = None,
    poly_n: int | None = None,
    poly_sigma: float | None = None,
    farneback_gaussian: bool = False,
    tau: float | None = None,
    lambda_: float | None = None,
    theta: float | None = None,
    nscales: int | None = None,
    warps: int | None = None,
    epsilon: float | None = None,
    inner_iterations: int | None = None,
    outer_iterations: int | None = None,
    scale_step: float | None = None,
    gamma: float | None = None,
    median_filtering: int | None = None,
    callback: Callback | None = None,
) -> Report:
    """Spot micro- and macro-expressions in long videos.

    Args:
        videos: Videos, or folders of frames.
        out: Folder of the results.
        force: Start over where the folder has results of other settings.
        shard: Process only part I of N; `auto` reads I and N from the variables of Slurm and other job engines, `auto/N` only I, as for Kubernetes and PBS.
        fps: Frames per second [default: the video's].
        method: How to estimate the flow: farneback, tvl1, srflow, raft, raft-small, gma, skflow, rpknet, dpflow, ccmr, ccmr-p, sea-raft-s, sea-raft-m, sea-raft-l, memflow, flownets, flownetc, flownetcss, flownet3-css, unimatch, unimatch-sc2, unimatch-sc2-ref6, ssa; a network followed by its weights, as in raft=FILE; srflow has its own.
        head_motion: The head's motion in the flow: keep or subtract.
        micro_score: Spot micro-expressions that stand out from noise and surroundings by this factor.
        macro_score: Spot macro-expressions that stand out from noise by this factor.
        face: Find the face with MediaPipe's networks, and write its landmarks next to the results; pass that file to `--landmarks` to repeat the run without the networks.
        face_index: Face to use if there are several; 1 is the leftmost.
        face_models: MediaPipe's networks: face_landmarker.task, its package as a folder or .whl file, or a folder with face_detection_short_range.tflite and face_landmark.tflite [default: $SRFLOW_FACE_MODELS, or the package that python3 has installed].
        face_box: Crop every frame to this box: LEFT,TOP,WIDTHxHEIGHT in pixels.
        landmarks: Align faces by the landmarks in this CSV file (dlib's 68 points or the eyes; see docs/guides/faces.md).
        refine: Refine the flow of every method with TV-L1 at full size; one scale and one warp, unless --nscales and --warps are set; the other parameters of tvl1 apply too.
        start: Start networks from the flow of this method, such as tvl1 or raft-small=FILE, in place of their own start.
        weights: Weights of the network: a file (PyTorch, Lightning, safetensors), or the name of published weights, such as things; `srflow models` lists them.
        iters: Refinement iterations; auto does the network's own number at most, and stops once the flow moves less than 0.07 px, auto:PX less than PX [default: the network's own, see `srflow models`].
        set: Network setting that the weights do not store; `srflow models` lists them.
        precision: Numbers that networks multiply: `f16` and `bf16` are less exact, but faster on GPUs with matrix units for them; `bf16` is up to twice as fast on CPUs with AVX512-BF16; `auto` uses them only there. Sums, softmax, norms and flow are always f32.
        device: Device to compute on; this build has cpu.
        tile: Estimate tile by tile and blend the overlaps; `auto` uses the largest tiles that fit into free memory, or none if the whole frame fits.
        tile_overlap: Overlap of neighbouring tiles in pixels, up to half a tile.
        scale: Resize the frames by this factor before estimation, and the flow back to full size.
        pyr_scale: Size of a pyramid level relative to the next finer one [default: 0.5].
        levels: Pyramid levels in addition to the full size [default: 5].
        winsize: Side of the averaging window in pixels [default: 13].
        iterations: Iterations at each level [default: 10].
        poly_n: Radius of the polynomial fit in pixels [default: 5].
        poly_sigma: Standard deviation of the fit's weight in pixels [default: 1.1].
        farneback_gaussian: Use a Gaussian averaging window in place of a box.
        tau: Time step of the dual update [default: 0.25].
        lambda_: Weight of the data term; smaller is smoother [default: 0.15].
        theta: Tightness of the coupling of data term and smoothness [default: 0.3].
        nscales: Number of scales [default: 5].
        warps: Warps at each scale [default: 5].
        epsilon: Stop iterating when the flow changes by less than this, in pixels [default: 0.01].
        inner_iterations: Iterations between two median filters [default: 30].
        outer_iterations: Median filters after each warp [default: 10].
        scale_step: Size of a scale relative to the next finer one [default: 0.8].
        gamma: Weight of an additional brightness change; 0 disables it [default: 0].
        median_filtering: Side of the median filter, 3 or 5 pixels, or 1 for none [default: 5].
        callback: Called with progress.
    """
    settings = locals()
    for name in ("videos",):
        settings[name] = _listed(settings[name])
    settings["lambda"] = settings.pop("lambda_")
    return _run("mer spot", settings)


def mer_predict(
    model: Path,
    inputs: str | Sequence[str],
    out: Path,
    *,
    clips: bool = False,
    least_probability: float = 0.5,
    model_method: str | None = None,
    apex: str = "course",
    force: bool = False,
    fps: float | None = None,
    method: str = "farneback",
    head_motion: str = "subtract",
    micro_score: float = 3.2,
    macro_score: float = 20,
    face: str | None = None,
    face_index: int | None = None,
    face_models: Path | None = None,
    face_box: str | None = None,
    landmarks: Path | None = None,
    refine: bool = False,
    start: str | None = None,
    weights: str | None = None,
    iters: str | None = None,
    set: dict[str, Any] | None = None,
    precision: str = "f32",
    device: str = "cpu",
    tile: str | None = None,
    tile_overlap: int = 128,
    scale: float | None = None,
    pyr_scale: float | None = None,
    levels: int | None = None,
    winsize: int | None = None,
    iterations: int | None = None,
    poly_n: int | None = None,
    poly_sigma: float | None = None,
    farneback_gaussian: bool = False,
    tau: float | None = None,
    lambda_: float | None = None,
    theta: float | None = None,
    nscales: int | None = None,
    warps: int | None = None,
    epsilon: float | None = None,
    inner_iterations: int | None = None,
    outer_iterations: int | None = None,
    scale_step: float | None = None,
    gamma: float | None = None,
    median_filtering: int | None = None,
    annotations: str | Sequence[str] | None = None,
    apex_list: Path | None = None,
    classes: str = "3",
    allow_missing: bool = False,
    only_key_frames: bool = False,
    callback: Callback | None = None,
) -> Report:
    """Classify micro-expressions in videos or clips with a trained model.

    Args:
        model: Folder of a model that `srflow mer run` saved, or rendered: a small one that comes with srflow, from rendered clips alone.
        inputs: Videos, folders of frames, or datasets.
        out: Folder of the results.
        clips: Take each video or folder as one clip, from its first to its last frame.
        least_probability: Name a class only if it is at least so probable.
        model_method: The model's flow method, if its weights are elsewhere now.
        apex: How to spot the apex of clips without one: course, strain or ratio.
        force: Start over where the folder has results of other settings.
        fps: Frames per second [default: the video's].
        method: How to estimate the flow: farneback, tvl1, srflow, raft, raft-small, gma, skflow, rpknet, dpflow, ccmr, ccmr-p, sea-raft-s, sea-raft-m, sea-raft-l, memflow, flownets, flownetc, flownetcss, flownet3-css, unimatch, unimatch-sc2, unimatch-sc2-ref6, ssa; a network followed by its weights, as in raft=FILE; srflow has its own.
        head_motion: The head's motion in the flow: keep or subtract.
        micro_score: Spot micro-expressions that stand out from noise and surroundings by this factor.
        macro_score: Spot macro-expressions that stand out from noise by this factor.
        face: Find the face with MediaPipe's networks, and write its landmarks next to the results; pass that file to `--landmarks` to repeat the run without the networks.
        face_index: Face to use if there are several; 1 is the leftmost.
        face_models: MediaPipe's networks: face_landmarker.task, its package as a folder or .whl file, or a folder with face_detection_short_range.tflite and face_landmark.tflite [default: $SRFLOW_FACE_MODELS, or the package that python3 has installed].
        face_box: Crop every frame to this box: LEFT,TOP,WIDTHxHEIGHT in pixels.
        landmarks: Align faces by the landmarks in this CSV file (dlib's 68 points or the eyes; see docs/guides/faces.md).
        refine: Refine the flow of every method with TV-L1 at full size; one scale and one warp, unless --nscales and --warps are set; the other parameters of tvl1 apply too.
        start: Start networks from the flow of this method, such as tvl1 or raft-small=FILE, in place of their own start.
        weights: Weights of the network: a file (PyTorch, Lightning, safetensors), or the name of published weights, such as things; `srflow models` lists them.
        iters: Refinement iterations; auto does the network's own number at most, and stops once the flow moves less than 0.07 px, auto:PX less than PX [default: the network's own, see `srflow models`].
        set: Network setting that the weights do not store; `srflow models` lists them.
        precision: Numbers that networks multiply: `f16` and `bf16` are less exact, but faster on GPUs with matrix units for them; `bf16` is up to twice as fast on CPUs with AVX512-BF16; `auto` uses them only there. Sums, softmax, norms and flow are always f32.
        device: Device to compute on; this build has cpu.
        tile: Estimate tile by tile and blend the overlaps; `auto` uses the largest tiles that fit into free memory, or none if the whole frame fits.
        tile_overlap: Overlap of neighbouring tiles in pixels, up to half a tile.
        scale: Resize the frames by this factor before estimation, and the flow back to full size.
        pyr_scale: Size of a pyramid level relative to the next finer one [default: 0.5].
        levels: Pyramid levels in addition to the full size [default: 5].
        winsize: Side of the averaging window in pixels [default: 13].
        iterations: Iterations at each level [default: 10].
        poly_n: Radius of the polynomial fit in pixels [default: 5].
        poly_sigma: Standard deviation of the fit's weight in pixels [default: 1.1].
        farneback_gaussian: Use a Gaussian averaging window in place of a box.
        tau: Time step of the dual update [default: 0.25].
        lambda_: Weight of the data term; smaller is smoother [default: 0.15].
        theta: Tightness of the coupling of data term and smoothness [default: 0.3].
        nscales: Number of scales [default: 5].
        warps: Warps at each scale [default: 5].
        epsilon: Stop iterating when the flow changes by less than this, in pixels [default: 0.01].
        inner_iterations: Iterations between two median filters [default: 30].
        outer_iterations: Median filters after each warp [default: 10].
        scale_step: Size of a scale relative to the next finer one [default: 0.8].
        gamma: Weight of an additional brightness change; 0 disables it [default: 0].
        median_filtering: Side of the median filter, 3 or 5 pixels, or 1 for none [default: 5].
        annotations: Annotation file outside its dataset's folder, such as samm:FILE or clips:FILE.
        apex_list: CSV list of apex frames, for clips without a usable one [default: SMIC's smic_apex.csv or data_apex.csv in its folder].
        classes: Classes: a name (see below), or your own TOML file (docs/reference/micro-expression-files.md).
        allow_missing: Tolerate missing frames; clips without onset or apex are dropped.
        only_key_frames: Accept clips that contain only the onset, apex and offset frames.
        callback: Called with progress.
    """
    settings = locals()
    for name in ("inputs", "annotations"):
        settings[name] = _listed(settings[name])
    settings["lambda"] = settings.pop("lambda_")
    return _run("mer predict", settings)


def mer_spot_score(
    predictions: Path | Sequence[Path],
    truth: str | Sequence[str],
    *,
    rule: str = "strict",
    types: str = "given",
    fps: float | None = None,
    callback: Callback | None = None,
) -> Report:
    """Score spotted intervals against the truth, as the Micro-Expression Grand Challenges do.

    Args:
        predictions: Spotted intervals: CSV files with the columns video, onset, offset, type.
        truth: True intervals: CSV files, or annotations of datasets (see below).
        rule: Rule of counting (see below).
        types: Type of a prediction: given in the file, by its duration (at most 0.5 s is micro), or also by its rise (at most 8/30 s to the apex).
        fps: Frames per second, for `--types` [default: the dataset's].
        callback: Called with progress.
    """
    settings = locals()
    for name in ("predictions", "truth"):
        settings[name] = _listed(settings[name])
    return _run("mer spot-score", settings)


def mer_strain(
    onset: Path,
    out: Path,
    *,
    apex: Path | None = None,
    features: Path | None = None,
    viz: Path | None = None,
    viz_max: float | None = None,
    method: str = "srflow",
    formula: str = "literature",
    resize: str | None = None,
    head_motion: str = "subtract",
    size: str = "112x112",
    force: bool = False,
    face: str | None = None,
    face_index: int | None = None,
    face_models: Path | None = None,
    face_box: str | None = None,
    landmarks: Path | None = None,
    refine: bool = False,
    start: str | None = None,
    weights: str | None = None,
    iters: str | None = None,
    set: dict[str, Any] | None = None,
    precision: str = "f32",
    device: str = "cpu",
    tile: str | None = None,
    tile_overlap: int = 128,
    scale: float | None = None,
    pyr_scale: float | None = None,
    levels: int | None = None,
    winsize: int | None = None,
    iterations: int | None = None,
    poly_n: int | None = None,
    poly_sigma: float | None = None,
    farneback_gaussian: bool = False,
    tau: float | None = None,
    lambda_: float | None = None,
    theta: float | None = None,
    nscales: int | None = None,
    warps: int | None = None,
    epsilon: float | None = None,
    inner_iterations: int | None = None,
    outer_iterations: int | None = None,
    scale_step: float | None = None,
    gamma: float | None = None,
    median_filtering: int | None = None,
    callback: Callback | None = None,
) -> Report:
    """Compute the optical strain between two frames.

    Args:
        onset: Onset frame, or a file of the flow from onset to apex.
        out: Strain as .npy array of shape (H, W).
        apex: Apex frame; none after a flow file.
        features: Also write u, v and strain, as .npy array of shape (3, 112, 112).
        viz: Draw the strain: black is zero, white the largest.
        viz_max: Strain drawn white [default: the largest].
        method: How to estimate the flow: farneback, tvl1, srflow, raft, raft-small, gma, skflow, rpknet, dpflow, ccmr, ccmr-p, sea-raft-s, sea-raft-m, sea-raft-l, memflow, flownets, flownetc, flownetcss, flownet3-css, unimatch, unimatch-sc2, unimatch-sc2-ref6, ssa; a network followed by its weights, as in raft=FILE; srflow has its own.
        formula: Formula: literature or off-tanet.
        resize: Resize to 112x112: the frames before estimating the flow, or the flow after [default: after].
        head_motion: The head's motion in the flow: keep or subtract.
        size: Size of the result.
        force: Overwrite existing files.
        face: Find the face with MediaPipe's networks, and write its landmarks next to the results; pass that file to `--landmarks` to repeat the run without the networks.
        face_index: Face to use if there are several; 1 is the leftmost.
        face_models: MediaPipe's networks: face_landmarker.task, its package as a folder or .whl file, or a folder with face_detection_short_range.tflite and face_landmark.tflite [default: $SRFLOW_FACE_MODELS, or the package that python3 has installed].
        face_box: Crop every frame to this box: LEFT,TOP,WIDTHxHEIGHT in pixels.
        landmarks: Align faces by the landmarks in this CSV file (dlib's 68 points or the eyes; see docs/guides/faces.md).
        refine: Refine the flow of every method with TV-L1 at full size; one scale and one warp, unless --nscales and --warps are set; the other parameters of tvl1 apply too.
        start: Start networks from the flow of this method, such as tvl1 or raft-small=FILE, in place of their own start.
        weights: Weights of the network: a file (PyTorch, Lightning, safetensors), or the name of published weights, such as things; `srflow models` lists them.
        iters: Refinement iterations; auto does the network's own number at most, and stops once the flow moves less than 0.07 px, auto:PX less than PX [default: the network's own, see `srflow models`].
        set: Network setting that the weights do not store; `srflow models` lists them.
        precision: Numbers that networks multiply: `f16` and `bf16` are less exact, but faster on GPUs with matrix units for them; `bf16` is up to twice as fast on CPUs with AVX512-BF16; `auto` uses them only there. Sums, softmax, norms and flow are always f32.
        device: Device to compute on; this build has cpu.
        tile: Estimate tile by tile and blend the overlaps; `auto` uses the largest tiles that fit into free memory, or none if the whole frame fits.
        tile_overlap: Overlap of neighbouring tiles in pixels, up to half a tile.
        scale: Resize the frames by this factor before estimation, and the flow back to full size.
        pyr_scale: Size of a pyramid level relative to the next finer one [default: 0.5].
        levels: Pyramid levels in addition to the full size [default: 5].
        winsize: Side of the averaging window in pixels [default: 13].
        iterations: Iterations at each level [default: 10].
        poly_n: Radius of the polynomial fit in pixels [default: 5].
        poly_sigma: Standard deviation of the fit's weight in pixels [default: 1.1].
        farneback_gaussian: Use a Gaussian averaging window in place of a box.
        tau: Time step of the dual update [default: 0.25].
        lambda_: Weight of the data term; smaller is smoother [default: 0.15].
        theta: Tightness of the coupling of data term and smoothness [default: 0.3].
        nscales: Number of scales [default: 5].
        warps: Warps at each scale [default: 5].
        epsilon: Stop iterating when the flow changes by less than this, in pixels [default: 0.01].
        inner_iterations: Iterations between two median filters [default: 30].
        outer_iterations: Median filters after each warp [default: 10].
        scale_step: Size of a scale relative to the next finer one [default: 0.8].
        gamma: Weight of an additional brightness change; 0 disables it [default: 0].
        median_filtering: Side of the median filter, 3 or 5 pixels, or 1 for none [default: 5].
        callback: Called with progress.
    """
    settings = locals()
    settings["lambda"] = settings.pop("lambda_")
    return _run("mer strain", settings)


def mer_features(
    data: str | Sequence[str],
    out: Path,
    *,
    method: str | Sequence[str] | None = None,
    force: bool = False,
    regions: str | None = None,
    cache: Path | None = None,
    annotations: str | Sequence[str] | None = None,
    apex_list: Path | None = None,
    classes: str = "3",
    allow_missing: bool = False,
    only_key_frames: bool = False,
    apex: str | None = None,
    strain: str = "literature",
    protocol: str | None = None,
    resize: str | None = None,
    head_motion: str | None = None,
    face: str | None = None,
    face_index: int | None = None,
    face_models: Path | None = None,
    face_box: str | None = None,
    landmarks: Path | None = None,
    refine: bool = False,
    start: str | None = None,
    weights: str | None = None,
    iters: str | None = None,
    set: dict[str, Any] | None = None,
    precision: str = "f32",
    device: str = "cpu",
    tile: str | None = None,
    tile_overlap: int = 128,
    scale: float | None = None,
    pyr_scale: float | None = None,
    levels: int | None = None,
    winsize: int | None = None,
    iterations: int | None = None,
    poly_n: int | None = None,
    poly_sigma: float | None = None,
    farneback_gaussian: bool = False,
    tau: float | None = None,
    lambda_: float | None = None,
    theta: float | None = None,
    nscales: int | None = None,
    warps: int | None = None,
    epsilon: float | None = None,
    inner_iterations: int | None = None,
    outer_iterations: int | None = None,
    scale_step: float | None = None,
    gamma: float | None = None,
    median_filtering: int | None = None,
    callback: Callback | None = None,
) -> Report:
    """Write flow and strain of every clip as one NumPy archive, for your own classifiers.

    Args:
        data: Datasets.
        out: Archive to write.
        method: How to estimate the flow from onset to apex: farneback, tvl1, srflow, raft, raft-small, gma, skflow, rpknet, dpflow, ccmr, ccmr-p, sea-raft-s, sea-raft-m, sea-raft-l, memflow, flownets, flownetc, flownetcss, flownet3-css, unimatch, unimatch-sc2, unimatch-sc2-ref6, ssa; networks with their weights, as in skflow=FILE; srflow has its own; files:DIR for flow files of another program; NAME:METHOD sets the name in tables, as in SRFlowNet:skflow=FILE; METHOD:iters=N sets the refinement iterations of one network.
        force: Overwrite an existing archive.
        regions: Also write how regions of the face and action units move: parts (brows, eyes, cheeks and so on) or mdmo (the 36 of MDMO).
        cache: Folder that caches each clip's features, shared with `srflow mer run` [default: none].
        annotations: Annotation file outside its dataset's folder, such as samm:FILE or clips:FILE.
        apex_list: CSV list of apex frames, for clips without a usable one [default: SMIC's smic_apex.csv or data_apex.csv in its folder].
        classes: Classes: a name (see below), or your own TOML file (docs/reference/micro-expression-files.md).
        allow_missing: Tolerate missing frames; clips without onset or apex are dropped.
        only_key_frames: Accept clips that contain only the onset, apex and offset frames.
        apex: How to spot the apex of clips without one: course, strain or ratio.
        strain: Formula of the optical strain: literature or off-tanet.
        protocol: Protocol: srflow (what recognizes most) or paper (the SRFlow paper's) [default: srflow; paper for --rows paper-tables-7-to-10].
        resize: Resize to 112x112: the frames before estimating the flow, or the flow after [default: the protocol's].
        head_motion: The head's motion in the flow: keep or subtract [default: the protocol's].
        face: Find the face with MediaPipe's networks, and write its landmarks next to the results; pass that file to `--landmarks` to repeat the run without the networks.
        face_index: Face to use if there are several; 1 is the leftmost.
        face_models: MediaPipe's networks: face_landmarker.task, its package as a folder or .whl file, or a folder with face_detection_short_range.tflite and face_landmark.tflite [default: $SRFLOW_FACE_MODELS, or the package that python3 has installed].
        face_box: Crop every frame to this box: LEFT,TOP,WIDTHxHEIGHT in pixels.
        landmarks: Align faces by the landmarks in this CSV file (dlib's 68 points or the eyes; see docs/guides/faces.md).
        refine: Refine the flow of every method with TV-L1 at full size; one scale and one warp, unless --nscales and --warps are set; the other parameters of tvl1 apply too.
        start: Start networks from the flow of this method, such as tvl1 or raft-small=FILE, in place of their own start.
        weights: Weights of the network: a file (PyTorch, Lightning, safetensors), or the name of published weights, such as things; `srflow models` lists them.
        iters: Refinement iterations; auto does the network's own number at most, and stops once the flow moves less than 0.07 px, auto:PX less than PX [default: the network's own, see `srflow models`].
        set: Network setting that the weights do not store; `srflow models` lists them.
        precision: Numbers that networks multiply: `f16` and `bf16` are less exact, but faster on GPUs with matrix units for them; `bf16` is up to twice as fast on CPUs with AVX512-BF16; `auto` uses them only there. Sums, softmax, norms and flow are always f32.
        device: Device to compute on; this build has cpu.
        tile: Estimate tile by tile and blend the overlaps; `auto` uses the largest tiles that fit into free memory, or none if the whole frame fits.
        tile_overlap: Overlap of neighbouring tiles in pixels, up to half a tile.
        scale: Resize the frames by this factor before estimation, and the flow back to full size.
        pyr_scale: Size of a pyramid level relative to the next finer one [default: 0.5].
        levels: Pyramid levels in addition to the full size [default: 5].
        winsize: Side of the averaging window in pixels [default: 13].
        iterations: Iterations at each level [default: 10].
        poly_n: Radius of the polynomial fit in pixels [default: 5].
        poly_sigma: Standard deviation of the fit's weight in pixels [default: 1.1].
        farneback_gaussian: Use a Gaussian averaging window in place of a box.
        tau: Time step of the dual update [default: 0.25].
        lambda_: Weight of the data term; smaller is smoother [default: 0.15].
        theta: Tightness of the coupling of data term and smoothness [default: 0.3].
        nscales: Number of scales [default: 5].
        warps: Warps at each scale [default: 5].
        epsilon: Stop iterating when the flow changes by less than this, in pixels [default: 0.01].
        inner_iterations: Iterations between two median filters [default: 30].
        outer_iterations: Median filters after each warp [default: 10].
        scale_step: Size of a scale relative to the next finer one [default: 0.8].
        gamma: Weight of an additional brightness change; 0 disables it [default: 0].
        median_filtering: Side of the median filter, 3 or 5 pixels, or 1 for none [default: 5].
        callback: Called with progress.
    """
    settings = locals()
    for name in ("data", "method", "annotations"):
        settings[name] = _listed(settings[name])
    settings["lambda"] = settings.pop("lambda_")
    return _run("mer features", settings)


def mer_run(
    data: str | Sequence[str],
    out: Path,
    *,
    method: str | Sequence[str] | None = None,
    classifier: str | None = None,
    sets: str = "both",
    force: bool = False,
    save_model: Path | None = None,
    cache: Path | None = None,
    epochs: int = 201,
    record_every: int = 20,
    batch: int = 64,
    learning_rate: float = 0.00065,
    balance: str = "none",
    augment: str = "none",
    seed: int = 0,
    seeds: int = 1,
    shard: str = "1/1",
    annotations: str | Sequence[str] | None = None,
    apex_list: Path | None = None,
    classes: str = "3",
    allow_missing: bool = False,
    only_key_frames: bool = False,
    apex: str | None = None,
    strain: str = "literature",
    protocol: str | None = None,
    resize: str | None = None,
    head_motion: str | None = None,
    face: str | None = None,
    face_index: int | None = None,
    face_models: Path | None = None,
    face_box: str | None = None,
    landmarks: Path | None = None,
    rows: str | None = None,
    weights_dir: Path = ".",
    skip_missing: bool = False,
    refine: bool = False,
    start: str | None = None,
    weights: str | None = None,
    iters: str | None = None,
    set: dict[str, Any] | None = None,
    precision: str = "f32",
    device: str = "cpu",
    tile: str | None = None,
    tile_overlap: int = 128,
    scale: float | None = None,
    pyr_scale: float | None = None,
    levels: int | None = None,
    winsize: int | None = None,
    iterations: int | None = None,
    poly_n: int | None = None,
    poly_sigma: float | None = None,
    farneback_gaussian: bool = False,
    tau: float | None = None,
    lambda_: float | None = None,
    theta: float | None = None,
    nscales: int | None = None,
    warps: int | None = None,
    epsilon: float | None = None,
    inner_iterations: int | None = None,
    outer_iterations: int | None = None,
    scale_step: float | None = None,
    gamma: float | None = None,
    median_filtering: int | None = None,
    callback: Callback | None = None,
) -> Report:
    """Recognize micro-expressions with leave-one-subject-out cross-validation, and write the paper's tables.

    Args:
        data: Datasets.
        out: Folder for tables.{txt,csv,tex,md}, folds.csv, confusions.csv, comparisons.csv, predictions.csv, results.json and report.html.
        method: How to estimate the flow from onset to apex: farneback, tvl1, srflow, raft, raft-small, gma, skflow, rpknet, dpflow, ccmr, ccmr-p, sea-raft-s, sea-raft-m, sea-raft-l, memflow, flownets, flownetc, flownetcss, flownet3-css, unimatch, unimatch-sc2, unimatch-sc2-ref6, ssa; networks with their weights, as in skflow=FILE; srflow has its own; files:DIR for flow files of another program; NAME:METHOD sets the name in tables, as in SRFlowNet:skflow=FILE; METHOD:iters=N sets the refinement iterations of one network.
        classifier: Classifier of the features [default: the protocol's, linear or off-tanet].
        sets: Evaluate each dataset by itself, all together (composite), both, or each by what was learned from the others (cross).
        force: Overwrite these files.
        save_model: Also train a classifier on all clips, and save it in this folder for `srflow mer predict`.
        cache: Folder that caches features, for other runs too [default: features in --out].
        epochs: Epochs: passes over the training clips.
        record_every: Record the predictions every N epochs.
        batch: Batch size in clips.
        learning_rate: Initial learning rate of Adam; it is multiplied by 0.3 every 60 epochs.
        balance: Classes with few clips: none (every clip counts alike), weights (a clip counts by the inverse frequency of its class) or sampling (networks draw each class equally often).
        augment: Training clips: none (as they are), mirror (also mirrored) or mirror-rotate (also mirrored and rotated by some degrees).
        seed: Seed of the initial parameters, the order of clips and dropout.
        seeds: Train so many times, with this many seeds from --seed on; scores are means over them.
        shard: Process only part I of N; `auto` reads I and N from the variables of Slurm and other job engines, `auto/N` only I, as for Kubernetes and PBS.
        annotations: Annotation file outside its dataset's folder, such as samm:FILE or clips:FILE.
        apex_list: CSV list of apex frames, for clips without a usable one [default: SMIC's smic_apex.csv or data_apex.csv in its folder].
        classes: Classes: a name (see below), or your own TOML file (docs/reference/micro-expression-files.md).
        allow_missing: Tolerate missing frames; clips without onset or apex are dropped.
        only_key_frames: Accept clips that contain only the onset, apex and offset frames.
        apex: How to spot the apex of clips without one: course, strain or ratio.
        strain: Formula of the optical strain: literature or off-tanet.
        protocol: Protocol: srflow (what recognizes most) or paper (the SRFlow paper's) [default: srflow; paper for --rows paper-tables-7-to-10].
        resize: Resize to 112x112: the frames before estimating the flow, or the flow after [default: the protocol's].
        head_motion: The head's motion in the flow: keep or subtract [default: the protocol's].
        face: Find the face with MediaPipe's networks, and write its landmarks next to the results; pass that file to `--landmarks` to repeat the run without the networks.
        face_index: Face to use if there are several; 1 is the leftmost.
        face_models: MediaPipe's networks: face_landmarker.task, its package as a folder or .whl file, or a folder with face_detection_short_range.tflite and face_landmark.tflite [default: $SRFLOW_FACE_MODELS, or the package that python3 has installed].
        face_box: Crop every frame to this box: LEFT,TOP,WIDTHxHEIGHT in pixels.
        landmarks: Align faces by the landmarks in this CSV file (dlib's 68 points or the eyes; see docs/guides/faces.md).
        rows: Methods with their names and weights: a TOML file, or one of paper-table-2, paper-table-3, paper-table-4, paper-table-6, paper-tables-7-to-10.
        weights_dir: Folder with the weights of --rows.
        skip_missing: Leave out rows whose weights or networks are missing; the table lists them.
        refine: Refine the flow of every method with TV-L1 at full size; one scale and one warp, unless --nscales and --warps are set; the other parameters of tvl1 apply too.
        start: Start networks from the flow of this method, such as tvl1 or raft-small=FILE, in place of their own start.
        weights: Weights of the network: a file (PyTorch, Lightning, safetensors), or the name of published weights, such as things; `srflow models` lists them.
        iters: Refinement iterations; auto does the network's own number at most, and stops once the flow moves less than 0.07 px, auto:PX less than PX [default: the network's own, see `srflow models`].
        set: Network setting that the weights do not store; `srflow models` lists them.
        precision: Numbers that networks multiply: `f16` and `bf16` are less exact, but faster on GPUs with matrix units for them; `bf16` is up to twice as fast on CPUs with AVX512-BF16; `auto` uses them only there. Sums, softmax, norms and flow are always f32.
        device: Device to compute on; this build has cpu.
        tile: Estimate tile by tile and blend the overlaps; `auto` uses the largest tiles that fit into free memory, or none if the whole frame fits.
        tile_overlap: Overlap of neighbouring tiles in pixels, up to half a tile.
        scale: Resize the frames by this factor before estimation, and the flow back to full size.
        pyr_scale: Size of a pyramid level relative to the next finer one [default: 0.5].
        levels: Pyramid levels in addition to the full size [default: 5].
        winsize: Side of the averaging window in pixels [default: 13].
        iterations: Iterations at each level [default: 10].
        poly_n: Radius of the polynomial fit in pixels [default: 5].
        poly_sigma: Standard deviation of the fit's weight in pixels [default: 1.1].
        farneback_gaussian: Use a Gaussian averaging window in place of a box.
        tau: Time step of the dual update [default: 0.25].
        lambda_: Weight of the data term; smaller is smoother [default: 0.15].
        theta: Tightness of the coupling of data term and smoothness [default: 0.3].
        nscales: Number of scales [default: 5].
        warps: Warps at each scale [default: 5].
        epsilon: Stop iterating when the flow changes by less than this, in pixels [default: 0.01].
        inner_iterations: Iterations between two median filters [default: 30].
        outer_iterations: Median filters after each warp [default: 10].
        scale_step: Size of a scale relative to the next finer one [default: 0.8].
        gamma: Weight of an additional brightness change; 0 disables it [default: 0].
        median_filtering: Side of the median filter, 3 or 5 pixels, or 1 for none [default: 5].
        callback: Called with progress.
    """
    settings = locals()
    for name in ("data", "method", "annotations"):
        settings[name] = _listed(settings[name])
    settings["lambda"] = settings.pop("lambda_")
    return _run("mer run", settings)


def mer_tables(
    predictions: Path,
    out: Path | None = None,
    *,
    force: bool = False,
    callback: Callback | None = None,
) -> Report:
    """Recompute all tables from the predictions of a run.

    Args:
        predictions: Predictions of one or several methods.
        out: Also write tables.{txt,csv,tex,md}, folds.csv, confusions.csv and comparisons.csv into this folder.
        force: Overwrite these files.
        callback: Called with progress.
    """
    settings = locals()
    return _run("mer tables", settings)


__all__ = ["ablation", "avatar_capture", "avatar_eval", "avatar_export", "avatar_fit", "avatar_from_video", "avatar_import", "avatar_landmarks", "avatar_mesh", "avatar_train", "avatar_units", "check", "convert", "demo", "device", "device_network", "device_rasterizer", "eval", "face", "figure", "flow", "mer_apex", "mer_data", "mer_features", "mer_predict", "mer_run", "mer_spot", "mer_spot_score", "mer_strain", "mer_synth", "mer_synth_long", "mer_tables", "merge", "metrics", "models", "models_export", "models_inspect", "pack", "rasterize", "render", "shapes", "train", "view"]
