use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;
use srflow_avatar::{HeadPose, MeshMotion, PosedHead, add_mesh};
use srflow_core::Size;
use srflow_splat::gltf::GltfBuilder;
use srflow_splat::{Gaussians, NamedCamera, SplatFormat, Up, read_cameras, write_gaussians};

use crate::Context;
use crate::commands::convert::{parse_up, report_gaussians};
use crate::output::ensure_free;
use crate::posed_head::{HeadArgs, MovingHead};
use crate::usage::wrong_usage;

/// Most timesteps of an animation: viewers hold one texture layer per morph target, of which WebGL 2 promises 256.
const MOST_TIMESTEPS: usize = 256;

/// Write the Gaussians of a head in some pose, for viewers and other programs
///
/// The format follows from the extension: .ply, .splat, .spz or .glb; docs/guides/rasterize.md lists what each keeps. A .glb also holds the
/// mesh of the head in the same pose, the cameras of --camera, and with --animate the motion of the mesh; the Gaussians stay in their
/// pose. `srflow avatar mesh` writes the mesh alone.
#[derive(Args)]
#[command(after_help = "Examples:
  srflow avatar export --head builtin --action-units 12=0.8 -o smile.glb
  srflow avatar export --head avatar:DIR --timestep 12 --no-mesh -o frame.spz
  srflow avatar export --head avatar:DIR --animate 100 --fps 25 --camera DIR/transforms.json -o talking.glb")]
pub struct Export {
    #[command(flatten)]
    head: HeadArgs,
    /// File to write: .ply, .splat, .spz or .glb
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Leave the mesh out of a .glb
    #[arg(long, conflicts_with = "animate")]
    no_mesh: bool,
    /// Move the mesh of a .glb through this many timesteps of the motion, from --timestep on
    #[arg(long, value_name = "N", conflicts_with = "action_units")]
    animate: Option<usize>,
    /// Timesteps per second of --animate
    #[arg(long, value_name = "RATE", default_value_t = 25, requires = "animate", value_parser = clap::value_parser!(u16).range(1..=1000))]
    fps: u16,
    /// Cameras to write into a .glb: any file that `srflow rasterize --camera` takes
    #[arg(long, value_name = "CAM")]
    camera: Option<PathBuf>,
    /// Size of the pictures, where CAM does not store one
    #[arg(long, value_name = "WIDTHxHEIGHT", requires = "camera")]
    size: Option<Size>,
    /// Direction that is up in a .ply: y, as in the world of the head, or -y, as many viewers of .ply expect it
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true, default_value = "y", value_parser = parse_up)]
    ply_up: Up,
    /// Overwrite the file
    #[arg(long)]
    force: bool,
}

pub fn run(args: Export, context: &Context) -> anyhow::Result<()> {
    let Some(format) = SplatFormat::of(&args.output) else {
        wrong_usage!(
            "{}: expected a file ending in {} (`srflow avatar mesh` writes a mesh alone, as .obj too)",
            args.output.display(),
            SplatFormat::extensions()
        );
    };
    let is_scene = format.extension == "glb";
    if !is_scene && (args.animate.is_some() || args.camera.is_some()) {
        wrong_usage!("{}: only a .glb holds a motion and cameras", args.output.display());
    }
    if args.animate.is_some_and(|timesteps| !(2..=MOST_TIMESTEPS).contains(&timesteps)) {
        wrong_usage!("--animate: expected 2 to {MOST_TIMESTEPS} timesteps");
    }
    ensure_free([&args.output], args.force)?;
    let size = args.size.map(|size| (size.width, size.height));
    let cameras = args.camera.as_deref().map(|file| read_cameras(file, size)).transpose()?;
    let Some(head) = args.head.open()? else { wrong_usage!("give a head: --head HEAD") };
    let mut posed = PosedHead::default();
    let mut gaussians = Gaussians::default();
    head.avatar.gaussians_into(&args.head.pose(&head)?, &mut posed, &mut gaussians);
    let named = || format!("writing {}", args.output.display());
    if is_scene {
        scene(&args, &head, posed.vertices(), &gaussians, &cameras.unwrap_or_default())
            .with_context(named)?;
    } else {
        if format.up.unwrap_or(args.ply_up) == Up::MinusY {
            gaussians.turn_about_x();
        }
        write_gaussians(&args.output, &gaussians)?;
    }
    report_gaussians(&args.output, format, &gaussians, context)
}

/// Gaussians, mesh, cameras and motion in one file.
fn scene(
    args: &Export,
    head: &MovingHead,
    vertices: &[glam::Vec3],
    gaussians: &Gaussians,
    cameras: &[NamedCamera],
) -> anyhow::Result<()> {
    let in_file = |problem: srflow_files::FileProblem| problem.in_file(&args.output);
    let mut builder = GltfBuilder::new();
    builder.add_gaussians(gaussians).map_err(in_file)?;
    if !args.no_mesh {
        let motion = args.animate.map(|timesteps| motion(args, head, timesteps)).transpose()?;
        let model = head.avatar.model();
        add_mesh(&mut builder, vertices, &model.triangles, model.texture.as_ref(), motion.as_ref())
            .map_err(in_file)?;
    }
    builder.add_cameras(cameras);
    Ok(builder.write(&args.output)?)
}

fn motion(args: &Export, head: &MovingHead, timesteps: usize) -> anyhow::Result<MeshMotion> {
    let first = args.head.first_timestep();
    let poses = head.poses();
    let Some(poses) = poses.get(first..first.saturating_add(timesteps)) else {
        let left = poses.len().saturating_sub(first);
        wrong_usage!("--animate {timesteps}: the motion has {left} timesteps from {first} on");
    };
    let vertices = |pose: &HeadPose| {
        let mut vertices = Vec::new();
        head.avatar.model().vertices(head.avatar.shaped(), pose, &mut vertices);
        vertices
    };
    Ok(MeshMotion { further: poses.iter().skip(1).map(vertices).collect(), rate: f32::from(args.fps) })
}
