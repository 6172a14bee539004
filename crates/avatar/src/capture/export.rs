//! A tracked head beside the pictures that it was tracked in.

use std::path::{Path, PathBuf};

use glam::{DMat4, DVec3, Vec3};
use srflow_files::{FileError, create_folder};

use super::{CANONICAL_NAME, CaptureView, HeadRecord, write_transforms};
use srflow_head::{HeadModel, HeadParameters, PoseParameters};

/// The folder of the head's parameters in a capture.
pub const PARAMETERS_FOLDER: &str = "flame_param";

/// Jaw rotation of the canonical head, whose mouth is open (`write_canonical_flame_param` of VHAP).
const OPEN_JAW: Vec3 = Vec3::new(0.3, 0.0, 0.0);

/// The file of the head's parameters at a timestep, relative to the folder of the capture.
pub fn parameters_name(timestep: u32) -> PathBuf {
    Path::new(PARAMETERS_FOLDER).join(format!("{timestep:05}.npz"))
}

/// Writes the parameters of the head at rest with its mouth open into `dir`; `identity` has its shape.
///
/// # Errors
/// When the file cannot be written.
pub fn write_canonical(dir: &Path, model: &HeadModel, identity: &HeadParameters) -> Result<(), FileError> {
    let others = model.joints.iter().filter(|joint| joint.role.is_none()).count();
    let canonical = PoseParameters {
        expr: vec![0.0; model.expressions.len()],
        jaw: OPEN_JAW,
        other_joints: vec![Vec3::ZERO; others],
        ..PoseParameters::default()
    };
    let canonical = HeadParameters {
        shape: identity.shape.clone(),
        static_offset: identity.static_offset.clone(),
        poses: vec![canonical],
    };
    canonical.write(&dir.join(CANONICAL_NAME), model.template.len(), false)
}

/// Writes a tracked head into `dir` as VHAP exports it: the parameters of each of `timesteps`, and lists of the pictures in `views`,
/// whose paths are relative to `dir`. As in VHAP, the world is moved such that the translations have a mean of zero; returns
/// where its origin was before.
///
/// # Errors
/// When a file cannot be written.
pub fn write_tracked(
    dir: &Path,
    model: &HeadModel,
    record: &HeadRecord,
    views: &[CaptureView],
    timesteps: &[u32],
    mut parameters: HeadParameters,
) -> Result<DVec3, FileError> {
    create_folder(&dir.join(PARAMETERS_FOLDER))?;
    let sum: DVec3 = parameters.poses.iter().map(|pose| pose.translation.as_dvec3()).sum();
    let origin = sum / parameters.poses.len().max(1) as f64;
    for pose in &mut parameters.poses {
        pose.translation = (pose.translation.as_dvec3() - origin).as_vec3();
    }
    let moved: Vec<CaptureView> = views
        .iter()
        .map(|view| {
            let mut view = view.clone();
            view.camera.camera_from_world *= DMat4::from_translation(origin);
            view.parameters = Some(parameters_name(view.timestep));
            view
        })
        .collect();
    record.write(dir)?;
    for (&timestep, pose) in timesteps.iter().zip(&parameters.poses) {
        let one = HeadParameters {
            shape: parameters.shape.clone(),
            static_offset: parameters.static_offset.clone(),
            poses: vec![pose.clone()],
        };
        one.write(&dir.join(parameters_name(timestep)), model.template.len(), false)?;
    }
    write_canonical(dir, model, &parameters)?;
    // The lists mark the export as complete, so they come last.
    write_transforms(dir, &moved)?;
    Ok(origin)
}
