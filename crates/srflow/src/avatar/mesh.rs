//! Meshes of head models.

use std::fmt;
use std::path::PathBuf;

use anyhow::Context as _;
use serde::{Deserialize, Serialize};
use srflow_avatar::HeadSource;
use srflow_head::{HeadParameters, HeadPose, MeshFormat, write_mesh};

use crate::clap::Args;
use crate::error::wrong_settings;
use crate::output::ensure_free;
use crate::posed_head::ActionUnits;
use crate::{Job, Report, Watch};

/// Write the mesh of a head model in some shape and pose
///
/// `srflow avatar export` writes the mesh of a person together with the Gaussians.
///
/// The parameters have VHAP's names (shape, expr, rotation, neck_pose, jaw_pose, eyes_pose, translation, static_offset,
/// dynamic_offset) for every kind of head; those that are missing are zero. docs/reference/avatar-files.md describes the kinds of head and
/// where their files come from.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[command(after_help = "Examples:
  srflow avatar mesh --model builtin -o head.obj
  srflow avatar mesh --model builtin --action-units 6=0.5,12=0.8 -o smile.obj
  srflow avatar mesh --model flame:generic_model.pkl --params flame_param.npz --timestep 12 -o frame.ply
  srflow avatar mesh --model gnm:gnm_head.npz --params smile.json -o smile.glb")]
pub struct MeshJob {
    /// Head model
    #[arg(long, value_name = "KIND:PATH", help = crate::render::head_help())]
    pub model: HeadSource,
    /// Parameters, .npz or .json [default: the head at rest]
    #[arg(long, value_name = "FILE")]
    #[serde(default)]
    pub params: Option<PathBuf>,
    /// Action units instead of parameters, 0 to 1 each, such as 6=0.5,12_L=1
    #[arg(long, value_name = "UNITS", conflicts_with = "params")]
    #[serde(default)]
    pub action_units: Option<ActionUnits>,
    /// Timestep of the parameters, from 0
    #[arg(long, value_name = "N", default_value_t, requires = "params")]
    #[serde(default)]
    pub timestep: usize,
    /// Seed of a built-in head
    #[arg(long, value_name = "N", default_value_t = default_seed())]
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// File to write: .obj, .ply or .glb
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// Overwrite the file
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
}

/// The seed of a built-in head where none is given.
pub(super) fn default_seed() -> u64 {
    1
}

impl Job for MeshJob {
    const NAME: &'static str = "avatar mesh";

    type Report = MeshReport;

    fn work(&self, _watch: &Watch) -> anyhow::Result<MeshReport> {
        let Self { model, params, action_units, timestep, seed, output, force } = self;
        if MeshFormat::of(output).is_none() {
            let known = MeshFormat::ALL.map(|format| format!(".{}", format.extension())).join(", ");
            wrong_settings!("{}: expected a file ending in {known}", output.display());
        }
        ensure_free([output], *force)?;
        let named = || format!("reading {model}");
        let model = model.model(*seed).with_context(named)?;
        let (shaped, pose) = match (params, action_units) {
            (None, None) => (model.shaped(&[]), HeadPose::default()),
            (None, Some(units)) => (model.shaped(&[]), units.pose(&model)?),
            (Some(_), Some(_)) => {
                wrong_settings!("`action_units` and `params` both pose the head: give one of them")
            }
            (Some(path), None) => {
                let parameters = HeadParameters::read(path)?;
                parameters.check(&model).with_context(|| path.display().to_string())?;
                let Some(pose) = parameters.poses.get(*timestep) else {
                    let last = parameters.poses.len() - 1;
                    wrong_settings!("`timestep` {timestep}: {} has timesteps 0 to {last}", path.display());
                };
                let shaped = model.shaped_with_offset(&parameters.shape, &parameters.static_offset);
                (shaped, pose.pose(&model))
            }
        };
        let mut vertices = Vec::new();
        model.vertices(&shaped, &pose, &mut vertices);
        let (vertices, triangles) = model.surface(&vertices);
        write_mesh(output, vertices, triangles, model.texture.as_ref())?;
        Ok(MeshReport { output: output.clone(), triangles: triangles.len(), vertices: vertices.len() })
    }
}

/// The mesh that [`MeshJob`] wrote.
#[derive(Debug, Clone, Serialize)]
pub struct MeshReport {
    pub output: PathBuf,
    pub triangles: usize,
    pub vertices: usize,
}

impl Report for MeshReport {}

impl fmt::Display for MeshReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { output, triangles, vertices } = self;
        writeln!(f, "{}: {triangles} triangles on {vertices} vertices", output.display())
    }
}
