use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;
use serde_json::json;
use srflow_avatar::{HeadParameters, HeadPose, HeadSource, MeshFormat, write_mesh};

use crate::Context;
use crate::commands::render::head_help;
use crate::output::{ensure_free, print_json_line};
use crate::posed_head::ActionUnits;
use crate::usage::wrong_usage;

/// Write the mesh of a head model in some shape and pose
///
/// `srflow avatar export` writes the mesh of a person together with the Gaussians.
///
/// The parameters have VHAP's names (shape, expr, rotation, neck_pose, jaw_pose, eyes_pose, translation, static_offset,
/// dynamic_offset) for every kind of head; those that are missing are zero. docs/reference/avatar-files.md describes the kinds of head and
/// where their files come from.
#[derive(Args)]
#[command(after_help = "Examples:
  srflow avatar mesh --model builtin -o head.obj
  srflow avatar mesh --model builtin --action-units 6=0.5,12=0.8 -o smile.obj
  srflow avatar mesh --model flame:generic_model.pkl --params flame_param.npz --timestep 12 -o frame.ply
  srflow avatar mesh --model gnm:gnm_head.npz --params smile.json -o smile.glb")]
pub struct Mesh {
    /// Head model
    #[arg(long, value_name = "KIND:PATH", help = head_help())]
    model: HeadSource,
    /// Parameters, .npz or .json (default: the head at rest)
    #[arg(long, value_name = "FILE")]
    params: Option<PathBuf>,
    /// Action units in place of parameters, 0 to 1 each, such as 6=0.5,12_L=1
    #[arg(long, value_name = "UNITS", conflicts_with = "params")]
    action_units: Option<ActionUnits>,
    /// Timestep of the parameters, from 0
    #[arg(long, value_name = "N", default_value_t = 0, requires = "params")]
    timestep: usize,
    /// Seed of a built-in head
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// File to write: .obj, .ply or .glb
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Overwrite the file
    #[arg(long)]
    force: bool,
}

pub fn run(args: Mesh, context: &Context) -> anyhow::Result<()> {
    if MeshFormat::of(&args.output).is_none() {
        let known = MeshFormat::ALL.map(|format| format!(".{}", format.extension())).join(", ");
        wrong_usage!("{}: expected a file ending in {known}", args.output.display());
    }
    ensure_free([&args.output], args.force)?;
    let model = args.model.model(args.seed).with_context(|| format!("reading {}", args.model))?;
    let (shaped, pose) = match (&args.params, &args.action_units) {
        (None, None) => (model.shaped(&[]), HeadPose::default()),
        (None, Some(units)) => (model.shaped(&[]), units.pose(&model)?),
        (Some(path), _) => {
            let parameters = HeadParameters::read(path)?;
            parameters.check(&model).with_context(|| path.display().to_string())?;
            let Some(pose) = parameters.poses.get(args.timestep) else {
                let last = parameters.poses.len() - 1;
                wrong_usage!("--timestep {}: {} has timesteps 0 to {last}", args.timestep, path.display());
            };
            let shaped = model.shaped_with_offset(&parameters.shape, &parameters.static_offset);
            (shaped, pose.pose(&model))
        }
    };
    let mut vertices = Vec::new();
    model.vertices(&shaped, &pose, &mut vertices);
    write_mesh(&args.output, &vertices, &model.triangles, model.texture.as_ref())?;
    if context.json {
        let (vertices, triangles) = (vertices.len(), model.triangles.len());
        print_json_line(&json!({ "output": args.output, "vertices": vertices, "triangles": triangles }))?;
    }
    Ok(())
}
