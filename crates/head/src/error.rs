use std::path::PathBuf;

use srflow_files::FileError;

use crate::HeadModelError;

/// Why a head model could not be read or dressed.
#[derive(Debug, thiserror::Error)]
pub enum HeadError {
    /// A file could not be read.
    #[error(transparent)]
    Read(#[from] FileError),
    /// A file of ICT-FaceKit's folder could not be read.
    #[error(
        "{0}. An ICT-FaceKit folder (FaceXModel) contains generic_neutral_mesh.obj, vertex_indices.json, identityNNN.obj and one OBJ per expression"
    )]
    IctFolder(#[source] FileError),
    /// A file is malformed.
    #[error("{}:{line}: {problem}", .path.display())]
    Malformed {
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// What was expected, and what was found.
        problem: String,
    },
    /// A mesh does not have the published topology.
    #[error("{}: {found} vertices, where the topology of {model} has {expected}; use the published file", .path.display())]
    Topology {
        path: PathBuf,
        /// Whose topology it is.
        model: &'static str,
        /// Vertices of the published topology.
        expected: usize,
        /// Vertices in the file.
        found: usize,
    },
    /// A shape has another number of vertices than the neutral mesh.
    #[error("{}: {found} vertices, but {} has {expected}; both must have the same topology", .path.display(), .reference.display())]
    VertexCount {
        /// The shape.
        path: PathBuf,
        /// Vertices in the shape.
        found: usize,
        /// The neutral mesh.
        reference: PathBuf,
        /// Vertices in the neutral mesh.
        expected: usize,
    },
    /// The head model is inconsistent.
    #[error(transparent)]
    Model(#[from] HeadModelError),
    /// The model has no landmarks, which place brows, lashes and the colours of the face.
    #[error(
        "the head model {model} has {found} landmarks; dressing it with Gaussians needs the 68 of dlib{}",
        if file.is_empty() { String::new() } else { format!(", in `{file}` beside it; `srflow avatar landmarks` finds them") }
    )]
    Landmarks {
        /// Name of the head model.
        model: String,
        /// Number of its landmarks.
        found: usize,
        /// The file that lists those of its kind; empty where they are part of the model.
        file: &'static str,
    },
}
