//! Gaussians of a head in files for other programs.

use std::path::PathBuf;

use anyhow::Context as _;
use serde::{Deserialize, Serialize};
use srflow_avatar::PosedHead;
use srflow_core::Size;
use srflow_head::{HeadPose, MeshMotion, add_mesh};
use srflow_splat::gltf::GltfBuilder;
use srflow_splat::{Gaussians, HalfTurn, NamedCamera, SplatFormat, Up, read_cameras, write_gaussians};

use crate::clap::Args;
use crate::convert::GaussiansWritten;
use crate::error::wrong_settings;
use crate::output::ensure_free;
use crate::posed_head::{HeadArgs, MovingHead};
use crate::video::default_fps;
use crate::{Job, Watch};

/// Most timesteps of an animation: viewers hold one texture layer per morph target, of which WebGL 2 promises 256.
const MOST_TIMESTEPS: usize = 256;

/// Write the Gaussians of a head in some pose, for viewers and other programs
///
/// The extension chooses the format: .ply, .splat, .spz or .glb; docs/guides/rasterize.md lists what each keeps. A .glb also holds the
/// mesh of the head in the same pose, the cameras of --camera, and with --animate the motion of the mesh; the Gaussians stay in their
/// pose. `srflow avatar mesh` writes the mesh alone.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[command(after_help = "Examples:
  srflow avatar export --head builtin --action-units 12=0.8 -o smile.glb
  srflow avatar export --head avatar:DIR --timestep 12 --no-mesh -o frame.spz
  srflow avatar export --head avatar:DIR --animate 100 --fps 25 --camera DIR/transforms.json -o talking.glb")]
pub struct ExportJob {
    #[command(flatten)]
    #[serde(flatten)]
    pub head: HeadArgs,
    /// File to write: .ply, .splat, .spz or .glb
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// Leave the mesh out of a .glb
    #[arg(long, conflicts_with = "animate")]
    #[serde(default)]
    pub no_mesh: bool,
    /// Animate the mesh of a .glb over N timesteps, starting at --timestep
    #[arg(long, value_name = "N", conflicts_with = "action_units")]
    #[serde(default)]
    pub animate: Option<usize>,
    /// Timesteps per second of --animate
    #[arg(long, value_name = "RATE", default_value_t = default_fps(), requires = "animate", value_parser = clap::value_parser!(u16).range(1..=1000))]
    #[serde(default = "default_fps")]
    pub fps: u16,
    /// Cameras to write into a .glb: any file that `srflow rasterize --camera` reads
    #[arg(long, value_name = "CAM")]
    #[serde(default)]
    pub camera: Option<PathBuf>,
    /// Size of the pictures, if CAM does not store it
    #[arg(long, value_name = "WIDTHxHEIGHT", requires = "camera")]
    #[serde(default)]
    pub size: Option<Size>,
    /// Up direction of the .ply: y, as for srflow's heads, or -y, as many viewers expect
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true, default_value_t)]
    #[serde(default)]
    pub ply_up: Up,
    /// Overwrite the file
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
}

impl Job for ExportJob {
    const NAME: &'static str = "avatar export";

    type Report = GaussiansWritten;

    fn work(&self, _watch: &Watch) -> anyhow::Result<GaussiansWritten> {
        let output = self.output.display();
        let Some(format) = SplatFormat::of(&self.output).filter(|format| format.is_written()) else {
            wrong_settings!(
                "{output}: expected a file ending in {} (`srflow avatar mesh` writes a mesh alone, as .obj too)",
                SplatFormat::written_extensions()
            );
        };
        let is_scene = format.extension == "glb";
        if !is_scene && (self.animate.is_some() || self.camera.is_some()) {
            wrong_settings!("{output}: only a .glb holds a motion and cameras");
        }
        if self.animate.is_some_and(|timesteps| !(2..=MOST_TIMESTEPS).contains(&timesteps)) {
            wrong_settings!("`animate`: expected 2 to {MOST_TIMESTEPS} timesteps");
        }
        ensure_free([&self.output], self.force)?;
        let cameras = self.camera.as_deref().map(|file| read_cameras(file, self.size)).transpose()?;
        let Some(head) = self.head.open()? else { wrong_settings!("`head`: give the head to export") };
        let mut posed = PosedHead::default();
        let mut gaussians = Gaussians::default();
        head.avatar.gaussians_into(&self.head.pose(&head)?, &mut posed, &mut gaussians);
        if is_scene {
            self.write_scene(&head, posed.vertices(), &gaussians, &cameras.unwrap_or_default())
                .with_context(|| format!("writing {output}"))?;
        } else {
            if format.up.unwrap_or(self.ply_up) == Up::MinusY {
                gaussians.half_turn(HalfTurn::X);
            }
            write_gaussians(&self.output, &gaussians)?;
        }
        Ok(GaussiansWritten::new(&self.output, format, &gaussians))
    }
}

impl ExportJob {
    /// Writes Gaussians, mesh, cameras and motion into one file.
    fn write_scene(
        &self,
        head: &MovingHead,
        vertices: &[glam::Vec3],
        gaussians: &Gaussians,
        cameras: &[NamedCamera],
    ) -> anyhow::Result<()> {
        let in_file = |problem: srflow_files::FileProblem| problem.in_file(&self.output);
        let mut builder = GltfBuilder::new();
        builder.add_gaussians(gaussians).map_err(in_file)?;
        if !self.no_mesh {
            let motion = self.animate.map(|timesteps| self.mesh_motion(head, timesteps)).transpose()?;
            let model = head.avatar.model();
            let (vertices, triangles) = model.surface(vertices);
            add_mesh(&mut builder, vertices, triangles, model.texture.as_ref(), motion.as_ref())
                .map_err(in_file)?;
        }
        builder.add_cameras(cameras);
        Ok(builder.write(&self.output)?)
    }

    fn mesh_motion(&self, head: &MovingHead, timesteps: usize) -> anyhow::Result<MeshMotion> {
        let first = self.head.first_timestep();
        let poses = head.poses();
        let Some(poses) = poses.get(first..first.saturating_add(timesteps)) else {
            let left = poses.len().saturating_sub(first);
            wrong_settings!("`animate` {timesteps}: the motion has {left} timesteps from {first} on");
        };
        let vertices = |pose: &HeadPose| {
            let mut vertices = Vec::new();
            head.avatar.model().vertices(head.avatar.shaped(), pose, &mut vertices);
            vertices.truncate(head.avatar.model().surface(&vertices).0.len());
            vertices
        };
        Ok(MeshMotion { further: poses.iter().skip(1).map(vertices).collect(), rate: f32::from(self.fps) })
    }
}
