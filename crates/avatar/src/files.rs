//! The files of an avatar, as GaussianAvatars writes them (`scene/flame_gaussian_model.py`, `save_ply` and `load_ply`):
//!
//! ```text
//! point_cloud.ply    Gaussians in the coordinates of the triangles of a head model
//! flame_param.npz    identity of the head, and its poses at the timesteps that it was trained on
//! head.json          which head model it is; of this project, missing where it is FLAME's
//! ```

use std::path::{Path, PathBuf};

use srflow_files::{FileError, FileProblem, create_folder};
use srflow_splat::{Gaussians, read_bound_ply, write_bound_ply};

use crate::capture::{HEAD_NAME, HeadRecord};
use crate::{Avatar, AvatarError};
use srflow_head::{HeadModel, HeadParameters};

const GAUSSIANS: &str = "point_cloud.ply";
const PARAMETERS: &str = "flame_param.npz";

/// The files that are read; the last may be missing.
pub(crate) const NAMES: [&str; 3] = [GAUSSIANS, PARAMETERS, HEAD_NAME];

/// An avatar as in its files, before it is put on a head model.
#[derive(Debug, Clone)]
pub struct AvatarFiles {
    /// The folder with `point_cloud.ply`.
    pub dir: PathBuf,
    /// In the coordinates of their triangles.
    pub gaussians: Gaussians,
    /// The triangle of each Gaussian.
    pub triangles: Vec<u32>,
    /// Identity and own motion.
    pub parameters: HeadParameters,
    /// The head model, if the files name it.
    pub head: Option<HeadRecord>,
}

impl AvatarFiles {
    /// Reads the files in `dir`, or those of the last iteration in a folder in which GaussianAvatars was trained
    /// (`point_cloud/iteration_600000`).
    ///
    /// # Errors
    /// When a file is missing or malformed.
    pub fn read(dir: &Path) -> Result<Self, FileError> {
        let dir = last_iteration(dir)?;
        let (gaussians, triangles) = read_bound_ply(&dir.join(GAUSSIANS))?;
        let parameters = HeadParameters::read(&dir.join(PARAMETERS))?;
        let head = HeadRecord::read(&dir)?;
        Ok(Self { dir, gaussians, triangles, parameters, head })
    }

    /// The avatar on its head model.
    ///
    /// # Errors
    /// When the model is not the one that the files belong to.
    pub fn on(self, model: HeadModel) -> Result<Avatar, AvatarError> {
        let Self { dir, gaussians, triangles, parameters, head } = self;
        if let Some(head) = head {
            head.check(&dir, &model)?;
        }
        Avatar::with_gaussians(model, parameters, gaussians, triangles)
            .map_err(|error| AvatarError::Misfit { dir, error: Box::new(error) })
    }
}

impl Avatar {
    /// Writes the avatar, with its identity and motion in `parameters`, into the folder `dir`. `head` names the model, so that the
    /// avatar can be read again; it may be omitted for FLAME's.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn write(
        &self,
        dir: &Path,
        parameters: &HeadParameters,
        head: Option<&HeadRecord>,
    ) -> Result<(), FileError> {
        create_folder(dir)?;
        if let Some(head) = head {
            head.write(dir)?;
        }
        parameters.write(&dir.join(PARAMETERS), self.model().template.len(), true)?;
        let bound = self.bound();
        write_bound_ply(&dir.join(GAUSSIANS), bound.local(), bound.triangles())
    }
}

/// The folder with the Gaussians: `dir`, or below it that of the highest iteration.
pub(crate) fn last_iteration(dir: &Path) -> Result<PathBuf, FileError> {
    if dir.join(GAUSSIANS).is_file() {
        return Ok(dir.to_owned());
    }
    let advice = "give the folder of an avatar, with point_cloud.ply and flame_param.npz, or point_cloud/iteration_N with them";
    let no_folder = |error| FileProblem::Place { doing: "opening", error, advice };
    std::fs::read_dir(dir).map_err(|error| no_folder(error).in_file(dir))?;
    let iterations = std::fs::read_dir(dir.join("point_cloud")).into_iter().flatten().flatten();
    let numbered = iterations.filter_map(|entry| {
        let number: u64 = entry.file_name().to_str()?.strip_prefix("iteration_")?.parse().ok()?;
        entry.path().join(GAUSSIANS).is_file().then(|| (number, entry.path()))
    });
    numbered.max().map(|(_, path)| path).ok_or_else(|| {
        let problem = FileProblem::Field {
            field: "folder",
            expected: format!("the folder of an avatar, with {GAUSSIANS} and {PARAMETERS}, or point_cloud/iteration_N with them"),
            found: "neither".to_owned(),
        };
        problem.in_file(dir)
    })
}
